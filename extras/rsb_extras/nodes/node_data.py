"""Nodes and their processes: what sides tell each other of them, consoles ask for, and both are limited to.

Times are whole seconds of the clock of the side that gives them (`rsb_bridge.feature_api.Context.now`); each message
and each result has that side's present time, so that the other one knows ages.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import PRINTABLE, Command, ControlMessageBase, Count, Name, Right, sanitize_text

MOST_NODES: Final = 1000
"""Of one side, those that have ended too. A round figure, twice as many as the largest robots have."""
MOST_PROCESSES: Final = 1000
MOST_LINES, LINE_LENGTH = 3, 200
"""Lines of a node that are kept, and characters of one."""
MOST_NAMES: Final = 400
"""Topics and services in each list of a node's details. A round figure."""
KEPT_FOR: Final = 3600.0
"""s for which a node that has ended is shown."""
PACKED_LIMIT: Final = 1 << 20
"""Bytes of an unpacked answer."""

_LATEST = 2**40  # s; any clock's time is less
Second: TypeAlias = Annotated[int, Meta(ge=-_LATEST, le=_LATEST)]
Text: TypeAlias = Annotated[str, Meta(max_length=LINE_LENGTH, pattern=PRINTABLE)]
Short: TypeAlias = Annotated[str, Meta(max_length=64, pattern=PRINTABLE)]
Number: TypeAlias = Annotated[int, Meta(ge=0, le=2**40)]


class LogLine(msgspec.Struct, frozen=True, array_like=True):
    """A line of /rosout.

    Attributes:
        level: 30 for WARN, 40 for ERROR, 50 for FATAL.
        at: when it came.
    """

    level: Annotated[int, Meta(ge=0, le=255)]
    at: Second
    text: Text


class FoundBy(StrEnum):
    """How a node's process was found."""

    NOT = ""
    GUID = "guid"
    NAME = "name"


class NodeState(msgspec.Struct, frozen=True, array_like=True):
    """A node.

    Attributes:
        name: full.
        machine: where it runs, or empty if unknown.
        pid: of its process on the bridge's machine, or 0.
        found_by: how that was found.
        count: number of running nodes of that name, 0 once it has ended.
        publishes: number of topics, as `hears`, and of services, as `serves`.
        lifecycle: state of a managed node in ROS's words, or empty.
        ends: how often it has ended in the last hour.
        ended: when it ended last, or None.
        line: its last WARN, ERROR or FATAL line, or None.
    """

    name: Name
    machine: Short = ""
    pid: Number = 0
    found_by: FoundBy = FoundBy.NOT
    count: Number = 1
    publishes: Number = 0
    hears: Number = 0
    serves: Number = 0
    lifecycle: Short = ""
    ends: Number = 0
    ended: Second | None = None
    line: LogLine | None = None

    @property
    def is_hidden(self) -> bool:
        """Whether ROS's tools hide it, by the beginning of its name."""
        return self.name.rpartition("/")[2].startswith("_")


class ProcessState(msgspec.Struct, frozen=True, array_like=True):
    """A process with nodes on the bridge's machine.

    Attributes:
        cpu: percent of one processor.
        memory: resident, in 10^6 bytes.
        since: when it started.
    """

    pid: Number
    name: Short
    cpu: Number
    memory: Number
    threads: Number
    since: Second


class NodeChanges(msgspec.Struct, frozen=True, array_like=True):
    """What has changed since an earlier answer, or all.

    Attributes:
        book: tells one beginning of the numbers from another.
        number: of the newest change in it.
        whole: whether it is all, so that the receiver forgets what it has.
        now: time of the side that gives it.
        gone: names of nodes, and pids of processes, that are shown no longer.
    """

    book: Count
    number: Count
    whole: bool
    now: Second
    nodes: Annotated[tuple[NodeState, ...], Meta(max_length=MOST_NODES)] = ()
    processes: Annotated[tuple[ProcessState, ...], Meta(max_length=MOST_PROCESSES)] = ()
    gone: Annotated[tuple[Name | Number, ...], Meta(max_length=MOST_NODES + MOST_PROCESSES)] = ()
    why_not: Text = ""
    """The reason why there is nothing, for an operator, or empty."""


class NameAndType(msgspec.Struct, frozen=True, array_like=True):
    name: Name
    type: Name


NamesOfNode: TypeAlias = Annotated[tuple[NameAndType, ...], Meta(max_length=MOST_NAMES)]


class NodeDetails(msgspec.Struct, frozen=True, array_like=True):
    """All that is known of one node.

    Attributes:
        now: time of the side that gives it.
        state: of the node, or None if there is none.
        process: it runs in, or None.
        lines: the last ones, oldest first.
        left_out: number of names for which the lists have no room, or that the other side does not show.
    """

    now: Second
    state: NodeState | None = None
    process: ProcessState | None = None
    publishes: NamesOfNode = ()
    hears: NamesOfNode = ()
    serves: NamesOfNode = ()
    calls: NamesOfNode = ()
    lines: Annotated[tuple[LogLine, ...], Meta(max_length=MOST_LINES)] = ()
    left_out: Count = 0


class AskNodes(ControlMessageBase, frozen=True):
    """Ask for what has changed among the peer's nodes since change `since` of `book`."""

    request: Count
    book: Count
    since: Count


class NodesNews(ControlMessageBase, frozen=True):
    """Answer `AskNodes`: `NodeChanges` as msgpack in a zstd frame."""

    request: Count
    packed: Annotated[bytes, Meta(max_length=PACKED_LIMIT)]


class AskNode(ControlMessageBase, frozen=True, omit_defaults=True):
    """Ask for the details of a node of the peer's, by its name, or of the one that publishes a topic."""

    request: Count
    node: Name = ""
    topic: Name = ""


class NodeTold(ControlMessageBase, frozen=True):
    """Answer `AskNode`: `NodeDetails` as msgpack in a zstd frame."""

    request: Count
    packed: Annotated[bytes, Meta(max_length=PACKED_LIMIT)]


class NodesSeen(NodeChanges, frozen=True, array_like=True):
    """An engine's answer to a console.

    Attributes:
        age: s since the side of these nodes has told of them.
    """

    age: Second = 0


class Nodes(Command[NodesSeen], frozen=True, tag="nodes"):
    """Return what has changed among the nodes of one side since an earlier answer."""

    right = Right.LOOK
    refreshes = False
    is_of_links = True
    link: str | None = None  # whose peer's nodes, or None for those of this side
    book: int = 0
    since: int = 0


class OneNode(Command[NodeDetails], frozen=True, tag="node"):
    """Return the details of a node, by its name, or of the one that publishes a topic."""

    right = Right.LOOK
    refreshes = False
    cancellable = True
    is_of_links = True
    link: str | None = None
    node: str = ""
    topic: str = ""


def moved_time(at: int, shift: int) -> int:
    """Return a time so many seconds later. A peer that lies about its clock moves it no further than times go."""
    return max(-_LATEST, min(_LATEST, at + shift))


def log_text(text: str) -> str:
    """Return the text of a log line as one line, printable and of limited length."""
    return sanitize_text(" ".join(text[: 4 * LINE_LENGTH].split()), LINE_LENGTH)
