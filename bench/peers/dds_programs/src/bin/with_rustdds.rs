//! A participant of RustDDS.

use std::collections::HashMap;

use dds_programs::{Participant, Qos, domain, event, heard, run};
use rustdds::{
    CDRDeserializerAdapter, CDRSerializerAdapter, DataReaderStatus, DomainParticipant, Duration, Publisher, QosPolicies,
    QosPolicyBuilder, StatusEvented, Subscriber, Topic, TopicKind, no_key, policy,
};
use serde::{Deserialize, Serialize};

#[derive(Debug, Serialize, Deserialize)]
struct Text {
    data: String,
}

type Writer = no_key::DataWriter<Text, CDRSerializerAdapter<Text>>;
type Reader = no_key::DataReader<Text, CDRDeserializerAdapter<Text>>;

struct Program {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    writers: HashMap<String, Writer>,
    readers: HashMap<String, Reader>,
}

impl Program {
    fn topic(&self, name: &str, qos: &QosPolicies) -> Topic {
        let kind = "std_msgs::msg::dds_::String_".to_string();
        self.participant.create_topic(format!("rt{name}"), kind, qos, TopicKind::NoKey).unwrap()
    }
}

impl Participant for Program {
    fn write(&mut self, topic: &str, qos: &Qos) {
        let qos = policies(qos);
        let writer = self.publisher.create_datawriter_no_key(&self.topic(topic, &qos), Some(qos)).unwrap();
        self.writers.insert(topic.to_string(), writer);
    }

    fn read(&mut self, topic: &str, qos: &Qos) {
        let qos = policies(qos);
        let reader = self.subscriber.create_datareader_no_key(&self.topic(topic, &qos), Some(qos)).unwrap();
        self.readers.insert(topic.to_string(), reader);
    }

    fn publish(&mut self, topic: &str, text: String) {
        if let Err(error) = self.writers[topic].write(Text { data: text }, None) {
            event(topic, &format!("unwritten {error:?}").chars().take(80).collect::<String>());
        }
    }

    fn poll(&mut self) {
        for (topic, reader) in &mut self.readers {
            while let Ok(Some(sample)) = reader.take_next_sample() {
                heard(topic, &sample.value().data);
            }
            while let Some(status) = reader.try_recv_status() {
                match status {
                    DataReaderStatus::RequestedDeadlineMissed { .. } => event(topic, "deadline"),
                    DataReaderStatus::LivelinessChanged { not_alive_total, .. } if not_alive_total.count() > 0 => {
                        event(topic, "not_alive")
                    }
                    _ => {}
                }
            }
        }
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
        readers: HashMap::new(),
    };
    run(&mut program);
}
