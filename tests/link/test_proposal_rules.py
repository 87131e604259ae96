"""A peer's proposal is checked as it is: the rules of a file refuse the same, in the same words, without its form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, cast, get_args

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.config.typed_topics_helpers import FIELDS, names

from rsb_bridge.config.decoding import read
from rsb_bridge.config.file_form import as_topic, as_written, foreign
from rsb_bridge.config.rights import rights_of_client
from rsb_bridge.config.topic_rules import topic_problems, unreported
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposals import amended, amended_topic, amendment, authorized, proposal_of, same_route, topic_of
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.limits import TOPIC_LENGTH
from rsb_bridge.model.names import server_topic
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.session import Client, Problem, Session, Topic, priority_of
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_bridge.model.transports import Protocol
from rsb_bridge.route.rate_limit import limits_changed
from rsb_bridge.route.route import route_weight
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.messages import Propose
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.wire.messages import Amend

TRANSPORTS = default_transports()
SESSIONS = {
    "ip": Session(name="pc", role="server", server_ip="10.0.0.1", server_port=50_000),
    "bluetooth": Session(name="pc", role="server", server_ip="00:11:22:33:44:55", server_port=5),
}


class Link:
    """A server's link with a client that may have everything.

    Attributes:
        prefixed: whether the client's topics have its name before theirs.
    """

    name = "robot1"
    is_client = False
    routes: ClassVar[dict[str, object]] = {}
    rights = rights_of_client(Client("robot1"), "pc")

    def __init__(self, session: Session, *, prefixed: bool) -> None:
        self.context = SimpleNamespace(session=session)
        self.prefixed = prefixed
        self.end = self

    def with_local_name(self, proposal: Propose) -> Propose:
        field = "remote_topic" if proposal.from_client else "topic"
        name = getattr(proposal, field)
        return msgspec.structs.replace(proposal, **{field: server_topic(name, "robot1") if self.prefixed else name})

    def refusal(self, topic: str) -> str:
        return ""


def refusal_by_form(topic: Topic, session: Session | None) -> str:
    """Return the first problem of a topic after it was written as in a file and read, or an empty string."""
    problems = [Problem(field, remedy) for field, remedy in foreign(topic).items()]
    written = as_written(topic)
    again = as_topic(topic.kind, read(msgspec.to_builtins(written), type(written), problems))
    found = problems + unreported(topic_problems(again, session, None), problems)
    return str(found[0]) if found else ""


def refusal(proposal: Propose, link: Link) -> str:
    """Return the reason for which a side refuses a proposal, or an empty string."""
    try:
        authorized(proposal, cast("BaseLink", link))
    except LinkError as error:
        return str(error)
    return ""


def proposed(topic: Topic) -> Propose:
    return proposal_of(topic, TRANSPORTS["tcp"], client_name="robot1", use_name=False)


changes: st.SearchStrategy[dict[str, Any]] = st.lists(
    st.sampled_from(
        [
            ("topic", names),
            ("remote_topic", names),
            ("from_client", st.booleans()),
            ("type", FIELDS["type"]),
            ("transport", st.sampled_from(get_args(Protocol))),
            ("port", st.integers(-1, 70_000) | st.sampled_from([1, 30])),
            ("qos", st.none() | FIELDS["qos"]),
            ("compression", st.sampled_from(["none", "zstd"])),
            *((name, FIELDS[name]) for name in ("max_rate", "expected_rate", "stale_after", "late_after", "max_age")),
            *(
                (name, FIELDS[name])
                for name in (
                    "arm",
                    "deadman",
                    "on_end",
                    "limits",
                    "keep",
                    "lazy",
                    "renew",
                    "express",
                    "beat",
                    "timeout",
                    "kind",
                )
            ),
            ("priority", st.sampled_from([-1, 0, 1, 2])),
        ]
    ).flatmap(lambda field: st.tuples(st.just(field[0]), field[1])),
    max_size=5,
).map(dict)
"""What is different in a proposal, be it right, wrong, or nothing that the wire carries."""


@example(changes={"remote_topic": f"/{'a' * (TOPIC_LENGTH - 2)}"}, prefixed=True, kind="ip")
@given(changes=changes, prefixed=st.booleans(), kind=st.sampled_from(list(SESSIONS)))
def test_refused_proposal_is_quoted_as_in_file(changes: dict[str, Any], prefixed: bool, kind: str) -> None:
    """First under the peer's names, because a prefix can make a valid name of an invalid one, and then under ours."""
    asked = {"message": "propose", "route": 1, "topic": "/a", "remote_topic": "/a", "from_client": True}
    try:
        proposal = decode(msgspec.msgpack.encode(asked | changes))
    except ProtocolError:
        return  # the wire does not carry it
    assert isinstance(proposal, Propose)
    if is_pattern(proposal.topic) or is_pattern(proposal.remote_topic):
        return  # refused before all else
    session = SESSIONS[kind]
    link = Link(session, prefixed=prefixed)
    expected = refusal_by_form(topic_of(proposal), None) or refusal_by_form(
        topic_of(link.with_local_name(proposal)), session
    )
    assert refusal(proposal, link) == expected


VALUES: dict[str, Any] = {
    "topic": "/b",
    "type": "std_msgs/msg/String",
    "qos": {"depth": 7},
    "remote_topic": "/c",
    "compression": "zstd",
    "priority": "high",
    "on_end": "none",
    "limits": VelocityLimits(0.5),
    "lazy": False,
    "beat": "front",
}
"""What is neither a number nor a switch."""


@pytest.mark.parametrize("key", sorted(TOPIC_KEYS.keys() & set(Propose.__struct_fields__)))
def test_peer_is_told_each_key_that_proposal_has(key: str) -> None:
    """A key that is added to the session and to the message needs a line in `proposal_of` and in `topic_of`."""
    value = VALUES.get(key, True if TOPIC_KEYS[key].value == "switch" else 7)
    topic = Topic(**{"topic": "/a", "direction": "transmit", "arm": True, key: value})
    received = topic_of(cast("Propose", decode(encode(proposed(topic)))))
    assert getattr(received, key) == value


@pytest.mark.parametrize("key", sorted(name for name, key in TOPIC_KEYS.items() if key.live))
def test_live_key_changes_while_route_is_open(key: str) -> None:
    before = Topic("/a", "transmit")
    after = msgspec.structs.replace(before, **{key: VALUES.get(key, True if TOPIC_KEYS[key].value == "switch" else 7)})
    assert same_route(proposed(before), proposed(after))
    change = decode(encode(amendment(proposed(after), 1)))
    assert amended(proposed(before), cast("Amend", change)) == proposed(after)
    assert amended_topic(before, proposed(after)) == after


def test_newer_side_s_ranks_count_as_nearest_word() -> None:
    """Else each of them would keep a part of the link, until nothing is left for the highest."""
    normal = proposed(Topic("/scan", "transmit"))
    weights = [route_weight(msgspec.structs.replace(normal, priority=rank), armed=False) for rank in range(-100, 101)]
    assert weights == [1] * 100 + [4] + [16] * 100
    assert [priority_of(rank) for rank in (-100, -1, 0, 1, 100)] == ["low", "low", "normal", "high", "high"]
    assert route_weight(msgspec.structs.replace(normal, priority=-1), armed=True) == 16


def test_a_priority_changes_while_the_route_is_open() -> None:
    normal, low = (proposed(Topic("/scan", "transmit", priority=each)) for each in ("normal", "low"))
    assert same_route(normal, low)
    assert "priority" in limits_changed(normal, low)
    assert amended_topic(Topic("/scan", "transmit"), amended(normal, amendment(low, 1))).priority == "low"
