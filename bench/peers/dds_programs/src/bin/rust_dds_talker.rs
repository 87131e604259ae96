//! `rust_dds_talker DOMAIN TOPIC` writes numbers as std_msgs/String, 20 a second, until it is killed.
//!
//! Its writer has no policy, so RustDDS announces it as reliable, and repeats nothing.

use std::net::{IpAddr, Ipv4Addr};
use std::{env, thread, time::Duration};

use rustdds::{DomainParticipantBuilder, QosPolicyBuilder, TopicKind};
use serde::Serialize;

#[derive(Debug, Serialize)]
struct Text {
    data: String,
}

fn main() {
    let arguments: Vec<String> = env::args().collect();
    let domain = arguments[1].parse().expect("a domain's number");
    let participant = DomainParticipantBuilder::new(domain)
        .with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)])
        .build()
        .expect("a participant");
    let none = QosPolicyBuilder::new().build();
    let topic = participant
        .create_topic(
            format!("rt{}", arguments[2]),
            "std_msgs::msg::dds_::String_".to_string(),
            &none,
            TopicKind::NoKey,
        )
        .expect("a topic");
    let publisher = participant.create_publisher(&none).expect("a publisher");
    let writer = publisher
        .create_datawriter_no_key_cdr::<Text>(&topic, None)
        .expect("a writer");
    for number in 1.. {
        let text = Text { data: number.to_string() };
        writer.write(text, None).expect("written");
        thread::sleep(Duration::from_millis(50));
    }
}
