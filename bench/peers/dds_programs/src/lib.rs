//! The lines by which `bench.foreign_dds` commands a program in a domain, as `bench/dds_ends.py` does with its own.

use std::{env, io, sync::mpsc, thread, time::Duration};

/// Policies of a writer or a reader. Times are in s; 0 is the default.
#[derive(Clone, Default)]
pub struct Qos {
    pub reliable: bool,
    pub latched: bool,
    pub depth: i32,
    pub deadline: f64,
    pub lifespan: f64,
    pub lease: f64,
    pub kind: Kind,
}

/// The type of messages.
#[derive(Clone, Copy, Default)]
pub enum Kind {
    #[default]
    String,
    /// test_msgs/KeyedString.
    KeyedString,
    /// std_msgs/String whose text is a key, as it is not for ROS.
    KeyString,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Kind::KeyedString => "test_msgs::msg::dds_::KeyedString_",
            _ => "std_msgs::msg::dds_::String_",
        }
    }
}

/// A participant with writers and readers.
pub trait Participant {
    fn write(&mut self, topic: &str, qos: &Qos);
    fn read(&mut self, topic: &str, qos: &Qos);
    fn publish(&mut self, topic: &str, text: String);
    /// Do what only some programs can.
    fn order(&mut self, words: &[&str]) {
        panic!("no such order: {words:?}");
    }
    /// Say all that has come since.
    fn poll(&mut self);
}

pub fn heard(topic: &str, text: &str) {
    let mark = text.split(' ').next().unwrap_or_default();
    println!("heard {topic} {mark} {}", text.len());
}

/// Return the key of a KeyedString: the last letter of its mark.
pub fn key_of(text: &str) -> String {
    text.split(' ').next().and_then(|mark| mark.chars().last()).into_iter().collect()
}

/// Say an event, such as a missed deadline.
pub fn event(topic: &str, what: &str) {
    println!("event {topic} {what}");
}

pub fn domain() -> u16 {
    env::args().nth(1).and_then(|each| each.parse().ok()).expect("a domain")
}

/// Do what the lines of standard input say, until it ends.
pub fn run(participant: &mut impl Participant) {
    let (lines, orders) = mpsc::channel();
    thread::spawn(move || io::stdin().lines().map_while(Result::ok).try_for_each(|line| lines.send(line)));
    println!("ready");
    loop {
        match orders.recv_timeout(Duration::from_millis(5)) {
            Ok(line) => {
                let words: Vec<&str> = line.split_whitespace().collect();
                match words[..] {
                    ["write", topic, ref policies @ ..] => participant.write(topic, &qos(policies)),
                    ["read", topic, ref policies @ ..] => participant.read(topic, &qos(policies)),
                    ["publish", topic, mark, size] => {
                        participant.publish(topic, format!("{mark} {}", "x".repeat(size.parse().expect("a size"))))
                    }
                    ref others => participant.order(others),
                }
            }
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => return,
        }
        participant.poll();
    }
}

fn qos(words: &[&str]) -> Qos {
    let mut qos = Qos { depth: 10, reliable: true, ..Qos::default() };
    for word in words {
        let (key, value) = word.split_once('=').unwrap_or((word, "0"));
        let number: f64 = value.parse().expect("a number");
        match key {
            "best_effort" => qos.reliable = false,
            "latched" => qos.latched = true,
            "depth" => qos.depth = number as i32,
            "deadline" => qos.deadline = number,
            "lifespan" => qos.lifespan = number,
            "lease" => qos.lease = number,
            "keyed" => qos.kind = Kind::KeyedString,
            "key" => qos.kind = Kind::KeyString,
            _ => panic!("no such policy: {word}"),
        }
    }
    qos
}
