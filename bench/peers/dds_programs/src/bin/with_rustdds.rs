//! A participant of RustDDS.

use std::collections::HashMap;

use dds_programs::{Kind, Participant, Qos, domain, event, heard, key_of, run};
use rustdds::{
    DataReaderStatus, DomainParticipant, Duration, Keyed, Publisher, QosPolicies, QosPolicyBuilder, StatusEvented,
    Subscriber, Topic, TopicKind, policy,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

#[derive(Debug, Serialize, Deserialize)]
struct Text {
    data: String,
}

impl Keyed for Text {
    type K = String;
    fn key(&self) -> String {
        self.data.clone()
    }
}

#[derive(Debug, Serialize, Deserialize)]
struct KeyedString {
    key: String,
    value: String,
}

impl Keyed for KeyedString {
    type K = String;
    fn key(&self) -> String {
        self.key.clone()
    }
}

struct Program {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    writers: HashMap<String, Box<dyn Fn(String) -> Result<(), String>>>,
    readers: Vec<Box<dyn FnMut()>>,
}

impl Program {
    fn topic(&self, name: &str, kind: Kind, qos: &QosPolicies) -> Topic {
        let has_key = if matches!(kind, Kind::String) { TopicKind::NoKey } else { TopicKind::WithKey };
        self.participant.create_topic(format!("rt{name}"), kind.name().to_string(), qos, has_key).unwrap()
    }

    fn write_keyed<T>(&mut self, name: &str, topic: &Topic, qos: QosPolicies, made: fn(String) -> T)
    where
        T: Keyed + std::fmt::Debug + Serialize + 'static,
    {
        let writer = self.publisher.create_datawriter_cdr::<T>(topic, Some(qos)).unwrap();
        let write = move |text| writer.write(made(text), None).map_err(|error| format!("{error:?}"));
        self.writers.insert(name.to_string(), Box::new(write));
    }

    fn read_keyed<T>(&mut self, name: &str, topic: &Topic, qos: QosPolicies, text: fn(T) -> String)
    where
        T: Keyed<K = String> + DeserializeOwned + 'static,
    {
        let mut reader = self.subscriber.create_datareader_cdr::<T>(topic, Some(qos)).unwrap();
        let name = name.to_string();
        self.readers.push(Box::new(move || {
            while let Ok(Some(sample)) = reader.take_next_sample() {
                if let Some(value) = sample.into_value().value() {
                    heard(&name, &text(value));
                }
            }
        }));
    }
}

impl Participant for Program {
    fn write(&mut self, name: &str, qos: &Qos) {
        let given = policies(qos);
        let topic = self.topic(name, qos.kind, &given);
        match qos.kind {
            Kind::String => {
                let writer = self.publisher.create_datawriter_no_key_cdr::<Text>(&topic, Some(given)).unwrap();
                let write = move |data| writer.write(Text { data }, None).map_err(|error| format!("{error:?}"));
                self.writers.insert(name.to_string(), Box::new(write));
            }
            Kind::KeyedString => {
                self.write_keyed(name, &topic, given, |value| KeyedString { key: key_of(&value), value })
            }
            Kind::KeyString => self.write_keyed(name, &topic, given, |data| Text { data }),
        }
    }

    fn read(&mut self, name: &str, qos: &Qos) {
        let given = policies(qos);
        let topic = self.topic(name, qos.kind, &given);
        match qos.kind {
            Kind::String => {
                let mut reader = self.subscriber.create_datareader_no_key_cdr::<Text>(&topic, Some(given)).unwrap();
                let name = name.to_string();
                self.readers.push(Box::new(move || {
                    while let Ok(Some(sample)) = reader.take_next_sample() {
                        heard(&name, &sample.value().data);
                    }
                    while let Some(status) = reader.try_recv_status() {
                        match status {
                            DataReaderStatus::RequestedDeadlineMissed { .. } => event(&name, "deadline"),
                            DataReaderStatus::LivelinessChanged { not_alive_total, .. }
                                if not_alive_total.count() > 0 =>
                            {
                                event(&name, "not_alive")
                            }
                            _ => {}
                        }
                    }
                }));
            }
            Kind::KeyedString => self.read_keyed(name, &topic, given, |message: KeyedString| message.value),
            Kind::KeyString => self.read_keyed(name, &topic, given, |message: Text| message.data),
        }
    }

    fn publish(&mut self, topic: &str, text: String) {
        if let Err(error) = self.writers[topic](text) {
            event(topic, &format!("unwritten {error}").chars().take(80).collect::<String>());
        }
    }

    fn poll(&mut self) {
        self.readers.iter_mut().for_each(|read| read());
    }
}

fn policies(qos: &Qos) -> QosPolicies {
    let mut builder = QosPolicyBuilder::new()
        .reliability(match qos.reliable {
            true => policy::Reliability::Reliable { max_blocking_time: Duration::from_millis(1000) },
            false => policy::Reliability::BestEffort,
        })
        .durability(if qos.latched { policy::Durability::TransientLocal } else { policy::Durability::Volatile })
        .history(policy::History::KeepLast { depth: qos.depth });
    if qos.deadline > 0.0 {
        builder = builder.deadline(policy::Deadline(Duration::from_frac_seconds(qos.deadline)));
    }
    if qos.lifespan > 0.0 {
        builder = builder.lifespan(policy::Lifespan { duration: Duration::from_frac_seconds(qos.lifespan) });
    }
    if qos.lease > 0.0 {
        let lease_duration = Duration::from_frac_seconds(qos.lease);
        builder = builder.liveliness(policy::Liveliness::ManualByTopic { lease_duration });
    }
    builder.build()
}

fn main() {
    let participant = DomainParticipant::new(domain()).unwrap();
    let plain = QosPolicyBuilder::new().build();
    let mut program = Program {
        publisher: participant.create_publisher(&plain).unwrap(),
        subscriber: participant.create_subscriber(&plain).unwrap(),
        participant,
        writers: HashMap::new(),
        readers: Vec::new(),
    };
    run(&mut program);
}
