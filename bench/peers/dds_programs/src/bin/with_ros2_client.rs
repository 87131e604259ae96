//! A node of ros2-client.
//!
//! Beside the lines of `dds_programs`: ``serve NAME MAPPING``, ``call NAME MAPPING`` of std_srvs/SetBool (``answered NAME MESSAGE``),
//! ``set NODE`` (``answered NODE``), ``tick SECOND`` to /clock. Its parameter is ``rate``.

use std::{collections::HashMap, thread};

use dds_programs::{Participant, Qos, domain, event, heard, run};
use ros2_client::{
    Client, Context, ContextOptions, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, ParameterValue,
    Publisher, QosProfile, Server, ServiceMapping, ServiceTypeName, Subscription, builtin_interfaces,
    parameters::raw::Parameter,
    qos,
    rcl_interfaces::{GetParametersRequest, GetParametersResponse, SetParametersRequest, SetParametersResponse},
};
use serde::{Deserialize, Serialize};

#[derive(Clone, Serialize, Deserialize)]
struct Request {
    data: bool,
}
impl Message for Request {}

#[derive(Clone, Serialize, Deserialize)]
struct Response {
    success: bool,
    message: String,
}
impl Message for Response {}

/// The parameter `rate` of another node.
struct Rate {
    sets: Client<SetParametersRequest, SetParametersResponse>,
    gets: Client<GetParametersRequest, GetParametersResponse>,
    number: i64,
}

struct Program {
    node: Node,
    writers: HashMap<String, Publisher<String>>,
    readers: HashMap<String, Subscription<String>>,
    servers: Vec<Server<Request, Response>>,
    clients: HashMap<String, Client<Request, Response>>,
    clock: Option<Publisher<builtin_interfaces::Time>>,
    rates: HashMap<String, Rate>,
}

impl Participant for Program {
    fn write(&mut self, topic: &str, qos: &Qos) {
        let (qos, kind) = (profile(qos), MessageTypeName::new("std_msgs", "String"));
        let made = self.node.create_topic(&name(topic), kind, &qos).unwrap();
        let publisher = self.node.create_publisher(&made, Some(qos)).unwrap();
        self.writers.insert(topic.to_string(), publisher);
    }

    fn read(&mut self, topic: &str, qos: &Qos) {
        let (qos, kind) = (profile(qos), MessageTypeName::new("std_msgs", "String"));
        let made = self.node.create_topic(&name(topic), kind, &qos).unwrap();
        let subscription = self.node.create_subscription(&made, Some(qos)).unwrap();
        self.readers.insert(topic.to_string(), subscription);
    }

    fn publish(&mut self, topic: &str, text: String) {
        if let Err(error) = self.writers[topic].publish(text) {
            event(topic, &format!("unwritten {error:?}").chars().take(80).collect::<String>());
        }
    }

    fn order(&mut self, words: &[&str]) {
        match *words {
            ["serve", service, mapping] => {
                let kind = ServiceTypeName::new("std_srvs", "SetBool");
                let (request, response) = (calls(), calls());
                let server = self.node.create_server(mapping_of(mapping), &name(service), &kind, request, response);
                self.servers.push(server.unwrap());
            }
            ["call", service, mapping] => {
                let node = &mut self.node;
                let client = self.clients.entry(service.to_string()).or_insert_with(|| {
                    let kind = ServiceTypeName::new("std_srvs", "SetBool");
                    node.create_client(mapping_of(mapping), &name(service), &kind, calls(), calls()).unwrap()
                });
                let _ = client.send_request(Request { data: true });
            }
            ["set", other] => {
                let node = &mut self.node;
                let rate = self.rates.entry(other.to_string()).or_insert_with(|| {
                    let (sets, gets) = (format!("{other}/set_parameters"), format!("{other}/get_parameters"));
                    let kind = |name| ServiceTypeName::new("rcl_interfaces", name);
                    let by = ServiceMapping::Enhanced;
                    Rate {
                        sets: node.create_client(by, &name(&sets), &kind("SetParameters"), calls(), calls()).unwrap(),
                        gets: node.create_client(by, &name(&gets), &kind("GetParameters"), calls(), calls()).unwrap(),
                        number: 100,
                    }
                });
                rate.number += 1;
                let value = ParameterValue::Integer(rate.number).into();
                let _ = rate.sets.send_request(SetParametersRequest {
                    parameter: vec![Parameter { name: "rate".to_string(), value }],
                });
            }
            ["tick", second] => {
                let node = &mut self.node;
                let clock = self.clock.get_or_insert_with(|| {
                    let qos = QosProfile::publisher_default();
                    let kind = MessageTypeName::new("builtin_interfaces", "Time");
                    let made = node.create_topic(&name("/clock"), kind, &qos).unwrap();
                    node.create_publisher(&made, Some(qos)).unwrap()
                });
                let _ = clock.publish(builtin_interfaces::Time::new(second.parse().unwrap(), 0));
            }
            _ => panic!("no such order: {words:?}"),
        }
    }

    fn poll(&mut self) {
        for (topic, subscription) in &self.readers {
            while let Ok(Some((text, _))) = subscription.take() {
                heard(topic, &text);
            }
        }
        for server in &self.servers {
            while let Ok(Some((id, request))) = server.receive_request() {
                let _ = server.send_response(id, Response { success: request.data, message: "done".to_string() });
            }
        }
        for (service, client) in &self.clients {
            while let Ok(Some((_, response))) = client.receive_response() {
                println!("answered {service} {}", response.message);
            }
        }
        for (node, rate) in &self.rates {
            while let Ok(Some((_, response))) = rate.sets.receive_response() {
                if response.results.iter().all(|result| result.successful) {
                    let _ = rate.gets.send_request(GetParametersRequest { names: vec!["rate".to_string()] });
                }
            }
            while let Ok(Some((_, response))) = rate.gets.receive_response() {
                if response.values.iter().any(|value| value.int_value == rate.number) {
                    println!("answered {node}");
                }
            }
        }
    }
}

fn name(whole: &str) -> Name {
    let (before, base) = whole.rsplit_once('/').unwrap();
    Name::new(if before.is_empty() { "/" } else { before }, base).unwrap()
}

fn mapping_of(word: &str) -> ServiceMapping {
    match word {
        "basic" => ServiceMapping::Basic,
        "cyclone" => ServiceMapping::Cyclone,
        _ => ServiceMapping::Enhanced,
    }
}

fn calls() -> QosProfile {
    QosProfile::publisher_default().history(qos::History::KeepLast { depth: 10 })
}

fn profile(given: &Qos) -> QosProfile {
    let mut profile = QosProfile::publisher_default();
    profile.reliability = match given.reliable {
        true => qos::Reliability::Reliable { when_full: qos::WhenFull::DEFAULT },
        false => qos::Reliability::BestEffort,
    };
    profile.durability = if given.latched { qos::Durability::TransientLocal } else { qos::Durability::Volatile };
    profile.history = qos::History::KeepLast { depth: given.depth as usize };
    let seconds = |number: f64| (number > 0.0).then(|| std::time::Duration::from_secs_f64(number));
    profile.deadline = seconds(given.deadline);
    profile.lifespan = seconds(given.lifespan);
    if let Some(lease) = seconds(given.lease) {
        profile.liveliness = qos::Liveliness::ManualByTopic;
        profile.liveliness_lease = Some(lease);
    }
    profile
}

fn main() {
    let context = Context::with_options(ContextOptions::new().domain_id(domain())).unwrap();
    let options = NodeOptions::new().enable_rosout(true).declare_parameter("rate", ParameterValue::Integer(5));
    let mut node = context.new_node(NodeName::new("/", "foreign").unwrap(), options).unwrap();
    let spinner = node.spinner().unwrap();
    thread::spawn(move || futures::executor::block_on(spinner.spin()));
    let mut program = Program {
        node,
        writers: HashMap::new(),
        readers: HashMap::new(),
        servers: Vec::new(),
        clients: HashMap::new(),
        clock: None,
        rates: HashMap::new(),
    };
    run(&mut program);
}
