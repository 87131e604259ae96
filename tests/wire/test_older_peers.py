"""Peers whose version knows nothing of calls, and this one: what either says, the other reads."""

from __future__ import annotations

import msgspec
import pytest

from rsb_bridge.model.qos import Qos
from rsb_bridge.wire.codec import decode, decode_hello, encode
from rsb_bridge.wire.messages import ControlMessage, Hello, ListTopics, Propose, Report, TopicList
from rsb_bridge.wire.records import CallsReport, SentReport, TopicEntry

SAID = {
    b"\x83\xa7message\xa6report\xa4sent\x91\x83\xa5route\x01\xa7offered\t\xa9delivered\t\xa8received\x90": Report(
        sent=(SentReport(route=1, offered=9, delivered=9),), received=()
    ),
    b"\x82\xa7message\xaalisttopics\xa7request\x01": ListTopics(request=1),
    b"\x83\xa7message\xa9topiclist\xa7request\x01\xa6topics\x91\x86\xa5topic\xa5/scan\xa4type\xa7a/msg/B\xa9type_hash"
    b"\xa0\xa3qos\xc0\xaapublishers\x00\xadsubscriptions\x01": TopicList(
        request=1, topics=(TopicEntry("/scan", "a/msg/B", "", None, 0, 1),)
    ),
    b"\xde\x00\x13\xa7message\xa7propose\xa5route\x01\xa5topic\xa5/scan\xacremote_topic\xac/robot1/scan\xabfrom_client"
    b"\xc3\xa4type\xa0\xa9transport\xa3tcp\xa4port\x00\xa3qos\xc0\xabcompression\xa4none\xa8max_rate\xcb\x00\x00\x00\x00"
    b"\x00\x00\x00\x00\xadexpected_rate\xcb\x00\x00\x00\x00\x00\x00\x00\x00\xabstale_after\xc0\xa6paused\xc2\xaepause_"
    b"revision\x00\xa3arm\xc2\xa7deadman\xcb\x00\x00\x00\x00\x00\x00\x00\x00\xa3who\xa0\xa6edited\xc2": Propose(
        route=1, topic="/scan", remote_topic="/robot1/scan", from_client=True
    ),
}
"""What version 0.1.0 sent before it carried calls, and what that says."""

NOT_KNOWN = {
    Propose: {"kind", "timeout"},
    Report: {"calls"},
    ListTopics: {"kinds"},
    TopicEntry: {"kind"},
}
"""The fields that it did not have."""


@pytest.mark.parametrize("said", SAID, ids=lambda said: type(SAID[said]).__name__)
def test_what_an_older_peer_says_is_read(said: bytes) -> None:
    assert decode(said) == SAID[said]


def test_an_older_peer_s_handshake_is_read() -> None:
    said = (
        b"\x87\xa7message\xa5hello\xa7version\xa50.1.0\xa4name\xa6robot1\xa8instance\xa3abc\xa9domain_id\x02\xa8features\x90"
        b"\xa4host\xa0"
    )
    assert decode_hello(said) == Hello("0.1.0", "robot1", "abc", 2, features=())


def _as_it_was(model: type[msgspec.Struct]) -> type[msgspec.Struct]:
    """A message as the older peer has it."""
    own = [field for field in msgspec.structs.fields(model) if field.name not in NOT_KNOWN.get(model, ())]
    fields = [(field.name, field.type) if field.required else (field.name, field.type, field.default) for field in own]
    return msgspec.defstruct(model.__name__, fields, tag_field="message", tag=str.lower, kw_only=True)


@pytest.mark.parametrize(
    "message",
    [
        Propose(route=1, topic="/scan", remote_topic="/scan", from_client=True, qos=Qos()),
        Propose(route=3, topic="/add", remote_topic="/add", from_client=True, kind="service", timeout=5.0),
        Report(sent=(), received=(), calls=(CallsReport(route=3, asked=4, answered=4),)),
        ListTopics(request=2, kinds=("service", "action")),
    ],
    ids=lambda message: type(message).__name__,
)
def test_an_older_peer_reads_what_it_knows(message: ControlMessage) -> None:
    older = msgspec.msgpack.Decoder(_as_it_was(type(message))).decode(encode(message))
    assert {name: getattr(older, name) for name in older.__struct_fields__} == {
        name: getattr(message, name) for name in older.__struct_fields__
    }
    assert set(message.__struct_fields__) - set(older.__struct_fields__) == NOT_KNOWN[type(message)]


def test_a_kind_that_only_a_newer_peer_has_does_not_end_the_connection() -> None:
    """The reader refuses it, or leaves it out."""
    proposal = Propose(route=1, topic="/a", remote_topic="/a", from_client=True, kind="telepathy")
    topics = TopicList(request=1, topics=(TopicEntry("/a", "", "", None, 0, 0, "telepathy"),))
    for message in (proposal, topics, ListTopics(request=1, kinds=("telepathy",))):
        assert decode(encode(message)) == message
