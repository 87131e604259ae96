"""The validation of a session and the wire accept the same values."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from tests.support.wording import pattern, says

from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.validation import SessionMistake, domain_of, validate, validate_topic
from rsb_bridge.link.proposals import proposal_of, topic_of
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.limits import (
    CHANNEL,
    DEPTH,
    DOMAIN,
    NAME_BYTES,
    QOS_TIME,
    RATE,
    SPEED,
    TOPIC_LENGTH,
    TURN_RATE,
    Range,
)
from rsb_bridge.model.qos import PROFILES, QosProblem
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.topic_keys import DEADMAN_TIME, STALE_AFTER
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.codec import decode, decode_hello, encode
from rsb_bridge.wire.messages import Hello, Propose
from rsb_bridge.wire.preamble import control_header, parse_control
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import CipherSuite

TRANSPORTS = default_transports()


def around(limits: Range) -> st.SearchStrategy[float]:
    """Numbers in a range, at its bounds, just beyond them, and far away."""
    bounds = [limits.low, limits.high]
    edges = [math.nextafter(bound, bound + step) for bound in bounds for step in (-1, 1)]
    return st.one_of(
        st.sampled_from([0.0, *bounds, *edges, limits.low / 2, limits.high * 10]),
        st.floats(limits.low, limits.high),
        st.floats(allow_nan=False),
    )


def names(longest: int) -> st.SearchStrategy[str]:
    """Well-formed topic names, up to a length, and often close to it."""
    lengths = st.one_of(st.integers(1, 30), st.integers(longest - 20, longest - 1))
    return lengths.map(lambda length: "/" + "a" * length)


depths = st.integers(-1, 20) | st.sampled_from([int(DEPTH.high), int(DEPTH.high) + 1, 1_000_000]) | st.integers()
policies = st.fixed_dictionaries(
    {},
    optional={
        "profile": st.sampled_from(list(PROFILES)),
        "reliability": st.sampled_from(["reliable", "best_effort"]),
        "history": st.sampled_from(["keep_last", "keep_all"]),
        "depth": depths,
        "deadline": around(QOS_TIME),
        "lifespan": around(QOS_TIME),
        "liveliness_lease_duration": around(QOS_TIME),
    },
)
TOPIC_FIELDS: dict[str, st.SearchStrategy[Any]] = {
    "topic": names(TOPIC_LENGTH + 1),
    "direction": st.sampled_from(["transmit", "receive"]),
    "type": st.sampled_from(["auto", "LaserScan", "a/B", f"a/msg/{'B' * 249}", f"a/msg/{'B' * 250}"]),
    "protocol": st.sampled_from([None, "tcp", "udp"]),
    "port": st.none() | st.integers(-1, 70_000),
    "qos": st.one_of(st.sampled_from(["auto", *PROFILES]), depths, policies),
    "remote_topic": st.none() | names(TOPIC_LENGTH + 1),
    "compression": st.sampled_from([None, "none", "zstd"]),
    "max_rate": st.none() | around(RATE),
    "expected_rate": st.none() | around(RATE),
    "stale_after": st.none() | around(STALE_AFTER),
    "paused": st.booleans(),
    "deadman": st.none() | around(DEADMAN_TIME),
    "limits": st.none() | st.builds(VelocityLimits, st.none() | around(SPEED), st.none() | around(TURN_RATE)),
    "keep": st.none() | around(Range(1, 86_400)),
}
some_fields = st.lists(
    st.sampled_from([*TOPIC_FIELDS]).flatmap(lambda key: st.tuples(st.just(key), TOPIC_FIELDS[key])), max_size=4
)
topics = some_fields.map(lambda fields: Topic(**{"topic": "/a", "direction": "transmit", "arm": True, **dict(fields)}))
"""With a few fields that may be wrong: of more, one nearly always is."""
sessions = st.builds(
    Session,
    name=st.one_of(
        st.just("robot1"),
        st.text(min_size=1, max_size=20),
        st.integers(1, NAME_BYTES + 1).map(lambda length: "r" * length),
    ),
    role=st.just("client"),
    server_ip=st.just("10.0.0.1"),
    server_port=st.just(49152),
    key_file=st.just("robot1.key"),
    use_name=st.booleans(),
    topics=st.lists(topics, max_size=3).map(tuple),
)


def proposed(session: Session, topic: Topic) -> Propose:
    transport = TRANSPORTS[topic.protocol or "tcp"]
    return proposal_of(topic, transport, client_name=session.name, use_name=session.use_name)


@given(sessions)
def test_what_the_validation_accepts_the_wire_carries(session: Session) -> None:
    if accepts(session):
        hello = Hello(version="1", name=session.name, instance="a", domain_id=0)
        assert decode_hello(encode(hello)) == hello
        assert parse_control(control_header(CipherSuite.PLAIN, session.name)).name == session.name
    for topic in session.topics:
        if accepts(session, topic):
            proposal = proposed(session, topic)
            assert decode(encode(proposal)) == proposal
            assert validate_topic(topic_of(proposal)) == [], "the other side accepts it too"


def accepts(session: Session, *topics: Topic) -> bool:
    return not validate(msgspec.structs.replace(session, topics=topics))


@given(
    fields=st.fixed_dictionaries(
        {"topic": names(TOPIC_LENGTH), "remote_topic": names(TOPIC_LENGTH), "from_client": st.booleans()},
        optional={
            "port": st.integers(-1, 70_000),
            "qos": policies.map(lambda qos: {key: value for key, value in qos.items() if key != "profile"}),
            "max_rate": around(RATE),
            "expected_rate": around(RATE),
            "stale_after": around(STALE_AFTER),
            "compression": st.sampled_from(["none", "zstd"]),
            "transport": st.sampled_from(["tcp", "udp", "bluetooth"]),
        },
    )
)
def test_what_the_wire_carries_the_validation_accepts(fields: dict[str, Any]) -> None:
    """Only the validation checks the range of a channel and the form of a name, and explains a refusal."""
    assume(fields.get("transport") != "bluetooth" or fields.get("port", 0) in (0, CHANNEL.low, CHANNEL.high))
    depth = fields.get("qos", {}).get("depth", 0)
    assume(-(2**63) <= depth < 2**64)  # else it is no msgpack
    try:
        proposal = decode(msgspec.msgpack.encode({"message": "propose", "route": 1} | fields))
    except ProtocolError:
        return
    assert isinstance(proposal, Propose)
    assert validate_topic(topic_of(proposal)) == []


@pytest.mark.parametrize(
    "qos", [{"depth": 100_001}, 1_000_000, {"deadline": 0.0009}, {"lifespan": 1e-9}, {"deadline": 1.1e9}]
)
def test_check_refuses_what_run_would(qos: int | dict[str, Any]) -> None:
    """Each of these was accepted in a file once, and ended the start or the link."""
    (problem,) = validate_topic(Topic("/scan", "transmit", qos=qos))
    assert problem.location == "qos"
    assert any(says(problem.message, code) for code in (QosProblem.DEPTH_OUT_OF_RANGE, QosProblem.TIME_OUT_OF_RANGE))


def test_a_topic_name_is_measured_with_its_prefix() -> None:
    longest = "/" + "a" * (TOPIC_LENGTH - len("/robot1") - 1)
    base = Session(name="robot1", role="client", server_ip="10.0.0.1", server_port=1, key_file="k", use_name=True)
    assert validate(msgspec.structs.replace(base, topics=(Topic(longest, "transmit"),))) == []
    (problem,) = validate(msgspec.structs.replace(base, topics=(Topic(longest + "a", "transmit"),)))
    assert problem.location == "topics[0].topic"
    assert says(problem.message, NameMistake.NAME_TOO_LONG_WITH_PREFIX, length=TOPIC_LENGTH + 1, limit=TOPIC_LENGTH)
    renamed = Topic(longest + "a", "transmit", remote_topic="/short")
    assert validate(msgspec.structs.replace(base, topics=(renamed,))) == []
    assert validate(msgspec.structs.replace(base, use_name=False, topics=(Topic(longest + "a", "transmit"),))) == []


@pytest.mark.parametrize(("variable", "domain"), [(None, 0), ("", 0), (" 7 ", 7), ("232", 232)])
def test_domain_is_session_s_else_environment_s(variable: str | None, domain: int) -> None:
    session = Session(name="a", role="server", server_ip="::", server_port=1)
    assert domain_of(session, variable) == domain
    assert domain_of(msgspec.structs.replace(session, domain_id=3), variable) == 3


@pytest.mark.parametrize("variable", ["233", "-1", "robot", "1.5"])
def test_an_environment_without_a_domain_is_named(variable: str) -> None:
    session = Session(name="a", role="server", server_ip="::", server_port=1)
    with pytest.raises(
        ValueError, match=pattern(SessionMistake.DOMAIN_VARIABLE_INVALID, value=repr(variable), range=DOMAIN)
    ):
        domain_of(session, variable)
