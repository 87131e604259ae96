//! A participant of Dust DDS.

use std::collections::HashMap;

use dds_programs::{Kind, Participant, Qos, domain, event, heard, key_of, run};
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
    publication::publisher::Publisher,
    subscription::{data_reader_listener::DataReaderListener, subscriber::Subscriber},
    topic_definition::topic::Topic,
    xtypes::type_support::TypeSupport,
};

#[derive(DdsType)]
#[dust_dds(extensibility = "final")]
struct Text {
    data: String,
}

#[derive(DdsType)]
#[dust_dds(extensibility = "final")]
struct KeyedString {
    #[dust_dds(key)]
    key: String,
    value: String,
}

/// A std_msgs/String whose text is a key.
#[derive(DdsType)]
#[dust_dds(extensibility = "final")]
struct KeyString {
    #[dust_dds(key)]
    data: String,
}

/// Says events of a reader: to ask for its statuses is not implemented.
struct Events {
    topic: String,
}

impl<T: Send + 'static> DataReaderListener<T> for Events {
    async fn on_requested_deadline_missed(&mut self, _: DataReaderAsync<T>, _: RequestedDeadlineMissedStatus) {
        event(&self.topic, "deadline");
    }

    async fn on_requested_incompatible_qos(&mut self, _: DataReaderAsync<T>, status: RequestedIncompatibleQosStatus) {
        event(&self.topic, &format!("incompatible {}", status.last_policy_id));
    }

    async fn on_liveliness_changed(&mut self, _: DataReaderAsync<T>, status: LivelinessChangedStatus) {
        if status.not_alive_count > 0 {
            event(&self.topic, "not_alive");
        }
    }
}

struct Program {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    writers: HashMap<String, Box<dyn Fn(String) -> Result<(), String>>>,
    readers: Vec<Box<dyn Fn()>>,
}

impl Program {
    fn topic<T: TypeSupport>(&self, name: &str, kind: Kind) -> Topic {
        self.participant
            .create_topic::<T>(&format!("rt{name}"), kind.name(), QosKind::Default, NO_LISTENER, NO_STATUS)
            .unwrap()
    }

    fn write_as<T: TypeSupport + Send + 'static>(&mut self, name: &str, qos: &Qos, made: fn(String) -> T) {
        let given = QosKind::Specific(DataWriterQos {
            reliability: reliability(qos),
            durability: durability(qos),
            history: history(qos),
            deadline: DeadlineQosPolicy { period: offered(qos.deadline) },
            lifespan: LifespanQosPolicy { duration: offered(qos.lifespan) },
            liveliness: liveliness(qos, offered),
            ..Default::default()
        });
        let topic = self.topic::<T>(name, qos.kind);
        let writer = self.publisher.create_datawriter::<T>(&topic, given, NO_LISTENER, NO_STATUS).unwrap();
        let write = move |text| writer.write(made(text), None).map_err(|error| format!("{error:?}"));
        self.writers.insert(name.to_string(), Box::new(write));
    }

    fn read_as<T: TypeSupport + Send + 'static>(&mut self, name: &str, qos: &Qos, text: fn(T) -> String) {
        let given = QosKind::Specific(DataReaderQos {
            reliability: reliability(qos),
            durability: durability(qos),
            history: history(qos),
            deadline: DeadlineQosPolicy { period: requested(qos.deadline) },
            liveliness: liveliness(qos, requested),
            ..Default::default()
        });
        let name = name.to_string();
        let events = Some(Events { topic: name.clone() });
        let told = &[
            StatusKind::RequestedDeadlineMissed,
            StatusKind::RequestedIncompatibleQos,
            StatusKind::LivelinessChanged,
        ];
        let topic = self.topic::<T>(&name, qos.kind);
        let reader = self.subscriber.create_datareader::<T>(&topic, given, events, told).unwrap();
        self.readers.push(Box::new(move || {
            // It is an error if there is none.
            for sample in reader.take(1000, ANY_SAMPLE_STATE, ANY_VIEW_STATE, ANY_INSTANCE_STATE).unwrap_or_default() {
                if let Some(message) = sample.data {
                    heard(&name, &text(message));
                }
            }
        }));
    }
}

impl Participant for Program {
    fn write(&mut self, topic: &str, qos: &Qos) {
        match qos.kind {
            Kind::String => self.write_as(topic, qos, |data| Text { data }),
            Kind::KeyedString => self.write_as(topic, qos, |value| KeyedString { key: key_of(&value), value }),
            Kind::KeyString => self.write_as(topic, qos, |data| KeyString { data }),
        }
    }

    fn read(&mut self, topic: &str, qos: &Qos) {
        match qos.kind {
            Kind::String => self.read_as(topic, qos, |message: Text| message.data),
            Kind::KeyedString => self.read_as(topic, qos, |message: KeyedString| message.value),
            Kind::KeyString => self.read_as(topic, qos, |message: KeyString| message.data),
        }
    }

    fn publish(&mut self, topic: &str, text: String) {
        if let Err(error) = self.writers[topic](text) {
            event(topic, &format!("unwritten {error}"));
        }
    }

    fn poll(&mut self) {
        self.readers.iter().for_each(|read| read());
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
        readers: Vec::new(),
    };
    run(&mut program);
}
