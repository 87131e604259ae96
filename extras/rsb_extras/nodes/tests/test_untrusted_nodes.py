"""Answers of a peer that lies, and lines of programs that write nonsense."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from tests.link.foreign_proposals_helpers import rogue
from tests.support.bridge import happened
from tests.support.waiting import eventually
from tests.wire.document_helpers import documented_fields

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.protocol_error import Broken
from rsb_extras import nodes
from rsb_extras.nodes.lifecycle_states import state_in
from rsb_extras.nodes.log_messages import Logged, read_log
from rsb_extras.nodes.node_data import AskNode, AskNodes, LogLine, NodeChanges, Nodes, NodesNews, NodeState, NodeTold

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

PAGE = Path(nodes.__file__).with_name("docs") / "nodes-protocol.md"
LINE = LogLine(40, 0, "stalled")
LINES = {"name": "front.lidar", "msg": "motor\nstalled", "file": "a.cpp", "function": "spin", "line": 7}


def test_the_page_documents_each_field() -> None:
    messages = AskNodes, NodesNews, AskNode, NodeTold
    found = {each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in messages}
    documented = documented_fields(PAGE.read_text(encoding="utf-8").partition("These are lists")[0])
    assert documented == found


def packed(changes: Any) -> bytes:
    return zstandard.compress(msgspec.msgpack.encode(changes))


BOMB = zstandard.compress(bytes(2 << 20))
BAD: list[Any] = [
    b"",
    b"no frame",
    BOMB,
    packed("text"),
    packed(NodeChanges(1, 1, True, 0, nodes=(NodeState("/a\x1b[2J"),))),
    packed(NodeChanges(1, 1, True, 0, nodes=(NodeState("/a", line=LogLine(40, 0, "x" * 201)),))),
    packed(NodeChanges(1, 1, True, 0, nodes=(NodeState("/a", count=-1),))),
    packed(NodeChanges(1, 1, True, 0, nodes=tuple(NodeState(f"/{number}") for number in range(1001)))),
    packed(NodeChanges(-1, 1, True, 0)),
    packed(NodeChanges(1, 1, True, 1 << 41)),
]


@pytest.mark.parametrize("answer", BAD, ids=range(len(BAD)))
def test_answer_out_of_bounds_ends_the_link(bridge: Bridge, answer: bytes) -> None:
    server = bridge.server()
    with rogue(bridge, "nodes") as client:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        asked = server.do(Nodes("robot1"))
        client.say(NodesNews(client.wait_for(AskNodes).request, answer))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)
        assert asked.exception(60) is not None


def test_answer_that_nobody_asked_for_is_not_read(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge, "nodes") as client:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        client.say(NodesNews(77, b"no frame"))
        asked = server.do(Nodes("robot1"))
        known = NodeChanges(1, 1, True, 0, nodes=(NodeState("/there", line=LINE),))
        client.say(NodesNews(client.wait_for(AskNodes).request, packed(known)))
        assert [each.name for each in asked.result(60).nodes] == ["/there"]


def test_line_is_read_from_its_bytes() -> None:
    line = bytes(serialize_message(Log(level=40, **LINES)))
    assert read_log(line) == Logged(40, "front.lidar", "motor stalled")
    assert read_log(bytes(serialize_message(Log(level=20, **LINES)))) is None
    assert all(read_log(line[:length]) is None for length in range(len(line) - 20 - len("a.cppspin")) if length < 40)


@given(st.binary(max_size=80), st.sampled_from([b"\x00\x00", b"\x00\x01", b""]))
def test_nonsense_is_no_line_and_no_state(content: bytes, head: bytes) -> None:
    line = read_log(head + content)
    assert line is None or len(line.text) <= 200
    assert len(state_in(head + content)) <= 32
