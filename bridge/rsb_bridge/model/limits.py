"""Limits on what operators and peers give, with their sources; ranges of topic keys: `rsb_bridge.model.topic_keys`.

`rsb_bridge.config.validation` applies them to sessions, `rsb_bridge.wire.records` to messages. Both read them here, so
that they accept the same values. Budgets of memory and time are in the modules that spend them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Range:
    """An inclusive range of numbers. NaN is in none."""

    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def __str__(self) -> str:
        return " to ".join(f"{bound:.0f}" if bound == int(bound) else f"{bound:g}" for bound in (self.low, self.high))


DOMAIN = Range(0, 232)
"""ROS domains whose ports fit below 65536 (DDSI-RTPS 2.5, section 9.6.1); Fast DDS ends the process beyond them."""
OUTLIVE = Range(0, 86_400)  # s that a link outlives its connections. A round figure: a day
PACE = Range(0, 0.02)
"""s that a turn of the ROS thread may wait for further messages: what a subscription keeps must last for so long."""
APART = 0.004
"""s of these, unless a session says otherwise (bench/README.md, *Turns apart*)."""
SAFE_DOMAIN = Range(0, 101)
"""ROS domains whose ports are clear of Linux's ephemeral range (docs.ros.org, "The ROS_DOMAIN_ID")."""
PORT = Range(1, 65535)  # TCP and UDP (RFC 9293, section 3.1; RFC 768); 0 lets the kernel choose
NO_PORT = Range(0, 0)  # of a transport whose addresses alone name the peer
DEFAULT_PORT = 7060
"""Below the ports of DDS (7400 + 250 for each domain), and of the kernel for outgoing connections (32768 to 60999)."""
TOPIC_PORT = Range(1024, PORT.high)
"""Ports that a server binds for a client's topics: lower ones are the system's (RFC 6335, section 6)."""
_FIRST_DDS_PORT = 7400
DDS_PORTS = 250  # ports of one ROS domain, the first ones from 7400 (DDSI-RTPS 2.5, section 9.6.1.1: PB 7400, DG 250)
_MULTICAST = (0, 1)
"""Offsets of the ports that all nodes of a domain share for discovery and for data (section 9.6.1.1: d0 0, d2 1)."""
_UNICAST = Range(10, 75)
"""Offsets of the ports of a domain's first 33 participants, two each (d1 10, d3 11, PG 2). Nodes that discover
each other without multicast look for so many at most: 4 with Fast DDS's defaults, 10 with Cyclone DDS's, some
dozens where a user raises that. Later participants take what is free."""
CHANNEL = Range(1, 30)  # RFCOMM server channels (Bluetooth RFCOMM 1.2, section 5.4)

NAME_BYTES = 255  # the name of a client or a server, in UTF-8: PROTOCOL.md section 1.1 gives its length one byte
TOPIC_LENGTH = 247
"""Characters of a full topic name, any prefix included (rmw/validate_full_topic_name.h, RMW_TOPIC_MAX_NAME_LENGTH)."""
FEATURE_VALUES = 32  # values of features' keys in a control message (PROTOCOL.md section 3)
TEXT_LENGTH = 255  # characters of a name, a topic or a type in a control message (PROTOCOL.md section 3)
REASON_LENGTH = 500  # characters of a reason or a problem in a control message (PROTOCOL.md section 3)

TIME = Range(-1e10, 2.5e11)  # seconds since the epoch that Python can write as a date (1653 to 9892)
DEPTH = Range(1, 100_000)  # messages that a QoS may ask for
KEPT_DEPTH = 10_000
"""Most messages that a receiver's publisher keeps for slow readers; a QoS may ask for more. A topic of 2 kHz brings as
many in 5 s (`qos.AUTO_SECONDS`)."""
LATCHED_DEPTH = 1000
"""Most messages of one publisher that the receiving side keeps for late joiners; the publisher may keep more.
/rosout has this depth."""
QOS_TIME = Range(0.001, 1e9)
"""s: a deadline, lifespan or lease where there is one. The shortest costs no timer storm, the longest is 30 years."""
RATE = Range(0.001, 1e6)  # Hz: a message in a quarter of an hour to more than DDS carries
SPEED = Range(0.01, 1000)  # m/s: a bound on what a hand may ask, from a robot that creeps to one that flies
TURN_RATE = Range(0.01, 1000)  # rad/s: the same for turning

ROUTES_PER_LINK = 1000  # routes that one peer may make the other side keep, as many as a Report lists (PROTOCOL.md, 3)
ROUTES_PROPOSED_BY_SERVER = 256
"""Routes of them that a server may have a client keep beyond the client's own: each costs endpoints in DDS, and the
client's own file may list more."""
OPERATORS = 32  # operators of one session. A round figure
PORTS_PER_CLIENT = 16
"""Ports of their own that a client's topics may have a server bind, unless its session lists them (`Session.ports`).
A round figure."""


def dds_ports(domain: int) -> Range:
    """Return the ports by which the nodes of a ROS domain find each other."""
    first = _FIRST_DDS_PORT + DDS_PORTS * domain
    return Range(first, first + DDS_PORTS - 1)


def discovery_domain(port: int) -> int | None:
    """Return the ROS domain whose nodes find each other by a port, or None if it is no domain's."""
    domain, offset = divmod(port - _FIRST_DDS_PORT, DDS_PORTS)
    return domain if domain in DOMAIN and (offset in _MULTICAST or offset in _UNICAST) else None
