"""What a peer says of nodes, and what programs write into /rosout and answer for their states."""

from __future__ import annotations

from typing import TypeVar

import msgspec
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from tests.fuzz.editing import edit_msgpack
from tests.fuzz.parser import Parser, check_text
from tests.fuzz.parsers.control_messages import check_message

from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_extras.nodes.lifecycle_states import state_in
from rsb_extras.nodes.link_nodes import in_time_of
from rsb_extras.nodes.log_messages import read_log
from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import (
    LINE_LENGTH,
    MOST_NODES,
    MOST_PROCESSES,
    AskNode,
    AskNodes,
    FoundBy,
    LogLine,
    NameAndType,
    NodeChanges,
    NodeDetails,
    NodesNews,
    NodeState,
    NodeTold,
    ProcessState,
)

T = TypeVar("T", NodeChanges, NodeDetails)

_LINE = LogLine(40, 3, "stalled")
_NODE = NodeState("/front/lidar", "robot1", 77, FoundBy.GUID, 1, 3, 2, 7, "active", 1, None, _LINE)
_PROCESS = ProcessState(77, "lidar", 40, 120, 9, 5)
_CHANGES = (
    NodeChanges(1, 3, True, 100, (_NODE, NodeState("/ended", ended=50)), (_PROCESS,)),
    NodeChanges(1, 4, False, 100, gone=("/front/lidar", 77)),
    NodeChanges(0, 0, True, 100, why_not="its session denies it"),
    NodeChanges(1, 3, True, -(2**40), (NodeState("/ended", ended=2**40, line=LogLine(40, 2**40, "")),), (_PROCESS,)),
)
_DETAILS = (
    NodeDetails(100, _NODE, _PROCESS, (NameAndType("/scan", "sensor_msgs/msg/LaserScan"),), lines=(_LINE,)),
    NodeDetails(-(2**40), NodeState("/ended", ended=2**40), _PROCESS, lines=(LogLine(40, 2**40, "stalled"),)),
)
_MESSAGES = (
    AskNodes(1, 0, 0),
    AskNodes(2, 5, 9),
    NodesNews(1, b"a frame"),
    AskNode(1, "/lidar"),
    NodeTold(1, b"a frame"),
)
_NOW = 1000
_LABEL = 32  # characters


def _read_message(data: bytes) -> None:
    try:
        message = decode(data)
    except ProtocolError:
        return
    if isinstance(message, AskNodes | NodesNews | AskNode | NodeTold):
        check_message(message)
        assert decode(encode(message)) == message


def _checked(content: T) -> T:
    """Return what a console reads of it."""
    check_message(content)
    read = msgspec.json.decode(msgspec.json.encode(content), type=type(content))
    assert read == content
    return read


def _read_changes(data: bytes) -> None:
    """A book takes them, and an operator's console what the book has then."""
    try:
        changes = msgspec.msgpack.decode(data, type=NodeChanges)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return
    book = NodeBook()
    for known in (_CHANGES[0], changes):
        book.take(known, _NOW)
    assert len(book.nodes) <= MOST_NODES
    assert len(book.processes) <= MOST_PROCESSES
    shown = _checked(book.changes(0, 0, _NOW))
    again = NodeBook()
    again.take(shown, _NOW)
    assert (again.nodes, again.processes) == (book.nodes, book.processes)


def _read_details(data: bytes) -> None:
    try:
        details = msgspec.msgpack.decode(data, type=NodeDetails)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return
    _checked(in_time_of(_NOW, details))


def _read_line(data: bytes) -> None:
    if (line := read_log(data)) is not None:
        check_text(line.text, LINE_LENGTH)


def _read_state(data: bytes) -> None:
    check_text(state_in(data), _LABEL)


_LOG = bytes(serialize_message(Log(level=40, name="front.lidar", msg="motor\nstalled\x1b[2J", file="a.cpp", line=7)))
_STATE = b"\0\1\0\0\3\0\0\0\7\0\0\0active\0"
PARSERS = (
    Parser("node_message", _read_message, tuple(map(encode, _MESSAGES)), edit_msgpack),
    Parser("node_changes", _read_changes, tuple(map(msgspec.msgpack.encode, _CHANGES)), edit_msgpack),
    Parser("node_details", _read_details, tuple(map(msgspec.msgpack.encode, _DETAILS)), edit_msgpack),
    Parser("node_log", _read_line, (_LOG,)),
    Parser("node_lifecycle", _read_state, (_STATE,)),
)
