//! A participant of Dust DDS.

use std::collections::HashMap;

use dds_programs::{Participant, Qos, domain, event, heard, run};
use dust_dds::{
    dds_async::data_reader::DataReaderAsync,
    domain::{domain_participant::DomainParticipant, domain_participant_factory::DomainParticipantFactory},
    infrastructure::{
        listener::NO_LISTENER,
        qos::{DataReaderQos, DataWriterQos, QosKind},
        qos_policy::*,
        sample_info::{ANY_INSTANCE_STATE, ANY_SAMPLE_STATE, ANY_VIEW_STATE},
        status::{LivelinessChangedStatus, NO_STATUS, RequestedDeadlineMissedStatus, RequestedIncompatibleQosStatus, StatusKind},
        time::{Duration, DurationKind},
        type_support::DdsType,
    },
    publication::{data_writer::DataWriter, publisher::Publisher},
    subscription::{data_reader::DataReader, data_reader_listener::DataReaderListener, subscriber::Subscriber},
    topic_definition::topic::Topic,
};

#[derive(DdsType)]
#[dust_dds(extensibility = "final")]
struct Text {
    data: String,
}

/// Says events of a reader: to ask for its statuses is not implemented.
struct Events {
    topic: String,
}

impl DataReaderListener<Text> for Events {
    async fn on_requested_deadline_missed(&mut self, _: DataReaderAsync<Text>, _: RequestedDeadlineMissedStatus) {
        event(&self.topic, "deadline");
    }

    async fn on_requested_incompatible_qos(&mut self, _: DataReaderAsync<Text>, status: RequestedIncompatibleQosStatus) {
        event(&self.topic, &format!("incompatible {}", status.last_policy_id));
    }

    async fn on_liveliness_changed(&mut self, _: DataReaderAsync<Text>, status: LivelinessChangedStatus) {
        if status.not_alive_count > 0 {
            event(&self.topic, "not_alive");
        }
    }
}

struct Program {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    writers: HashMap<String, DataWriter<Text>>,
    readers: HashMap<String, DataReader<Text>>,
}

impl Program {
    fn topic(&self, name: &str) -> Topic {
        let kind = "std_msgs::msg::dds_::String_";
        self.participant
            .create_topic::<Text>(&format!("rt{name}"), kind, QosKind::Default, NO_LISTENER, NO_STATUS)
            .unwrap()
    }
}

impl Participant for Program {
    fn write(&mut self, topic: &str, qos: &Qos) {
        let given = DataWriterQos {
            reliability: reliability(qos),
            durability: durability(qos),
            history: history(qos),
            deadline: DeadlineQosPolicy { period: offered(qos.deadline) },
            lifespan: LifespanQosPolicy { duration: offered(qos.lifespan) },
            liveliness: liveliness(qos, offered),
            ..Default::default()
        };
        let writer = self.publisher.create_datawriter(&self.topic(topic), QosKind::Specific(given), NO_LISTENER, NO_STATUS);
        self.writers.insert(topic.to_string(), writer.unwrap());
    }

    fn read(&mut self, topic: &str, qos: &Qos) {
        let given = DataReaderQos {
            reliability: reliability(qos),
            durability: durability(qos),
            history: history(qos),
            deadline: DeadlineQosPolicy { period: requested(qos.deadline) },
            liveliness: liveliness(qos, requested),
            ..Default::default()
        };
        let events = Some(Events { topic: topic.to_string() });
        let told = &[
            StatusKind::RequestedDeadlineMissed,
            StatusKind::RequestedIncompatibleQos,
            StatusKind::LivelinessChanged,
        ];
        let reader = self.subscriber.create_datareader(&self.topic(topic), QosKind::Specific(given), events, told);
        self.readers.insert(topic.to_string(), reader.unwrap());
    }

    fn publish(&mut self, topic: &str, text: String) {
        if let Err(error) = self.writers[topic].write(Text { data: text }, None) {
            event(topic, &format!("unwritten {error:?}"));
        }
    }

    fn poll(&mut self) {
        for (topic, reader) in &self.readers {
            // It is an error if there is none.
            for sample in reader.take(1000, ANY_SAMPLE_STATE, ANY_VIEW_STATE, ANY_INSTANCE_STATE).unwrap_or_default() {
                if let Some(text) = sample.data {
                    heard(topic, &text.data);
                }
            }
        }
    }
}

fn seconds(number: f64) -> Option<DurationKind> {
    (number > 0.0).then(|| DurationKind::Finite(Duration::new(number as i32, (number.fract() * 1e9) as u32)))
}

/// Return a writer's time, or what Fast DDS announces as infinite, which Dust DDS 0.16 takes for less than its own `Infinite`.
fn offered(number: f64) -> DurationKind {
    seconds(number).unwrap_or(DurationKind::Finite(Duration::new(i32::MAX, 999_999_999)))
}

fn requested(number: f64) -> DurationKind {
    seconds(number).unwrap_or(DurationKind::Infinite)
}

fn reliability(qos: &Qos) -> ReliabilityQosPolicy {
    let kind = if qos.reliable { ReliabilityQosPolicyKind::Reliable } else { ReliabilityQosPolicyKind::BestEffort };
    ReliabilityQosPolicy { kind, max_blocking_time: DurationKind::Finite(Duration::new(1, 0)) }
}

fn durability(qos: &Qos) -> DurabilityQosPolicy {
    let kind = if qos.latched { DurabilityQosPolicyKind::TransientLocal } else { DurabilityQosPolicyKind::Volatile };
    DurabilityQosPolicy { kind }
}

fn history(qos: &Qos) -> HistoryQosPolicy {
    HistoryQosPolicy { kind: HistoryQosPolicyKind::KeepLast(qos.depth as u32) }
}

fn liveliness(qos: &Qos, time: fn(f64) -> DurationKind) -> LivelinessQosPolicy {
    let kind = if qos.lease > 0.0 { LivelinessQosPolicyKind::ManualByTopic } else { LivelinessQosPolicyKind::Automatic };
    LivelinessQosPolicy { kind, lease_duration: time(qos.lease) }
}

fn main() {
    let factory = DomainParticipantFactory::get_instance();
    let participant = factory.create_participant(domain().into(), QosKind::Default, NO_LISTENER, NO_STATUS).unwrap();
    let mut program = Program {
        publisher: participant.create_publisher(QosKind::Default, NO_LISTENER, NO_STATUS).unwrap(),
        subscriber: participant.create_subscriber(QosKind::Default, NO_LISTENER, NO_STATUS).unwrap(),
        participant,
        writers: HashMap::new(),
        readers: HashMap::new(),
    };
    run(&mut program);
}
