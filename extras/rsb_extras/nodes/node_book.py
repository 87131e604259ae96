"""Nodes and processes with the number of their last change, so that only changes are sent."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

import msgspec

from rsb_extras.nodes.node_data import MOST_NODES, MOST_PROCESSES, NodeChanges, NodeState, ProcessState, moved_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_GONE_REMEMBERED = MOST_NODES
"""Names that are gone; a reader that has missed more of them gets all anew."""
_encode = msgspec.msgpack.Encoder().encode


class NodeBook:
    """The nodes and processes of one side.

    Args:
        identity: tells it from other books, also from that of a bridge's earlier life.

    Attributes:
        nodes: by full name.
        processes: by pid.
        number: of the newest change.
        why_not: the reason why there are none, for an operator, or empty.
    """

    def __init__(self, identity: int = 1) -> None:
        self.nodes: dict[str, NodeState] = {}
        self.processes: dict[int, ProcessState] = {}
        self.number = 0
        self.why_not = ""
        self._id = identity
        self._changed: OrderedDict[str | int, int] = OrderedDict()  # the number of each one's last change, in order
        self._gone: OrderedDict[str | int, int] = OrderedDict()
        self._complete_since = 0  # earlier ends are forgotten

    def put(self, state: NodeState | ProcessState) -> None:
        """Set the state of a node or a process, if there is room for it."""
        if isinstance(state, NodeState):
            if self.nodes.get(state.name) == state or (state.name not in self.nodes and len(self.nodes) >= MOST_NODES):
                return
            self.nodes[state.name] = state
            self._note(state.name)
        else:
            known, pid = self.processes, state.pid
            if known.get(pid) == state or (pid not in known and len(known) >= MOST_PROCESSES):
                return
            known[pid] = state
            self._note(pid)

    def drop(self, key: str | int) -> None:
        """Forget a node by its name, or a process by its pid."""
        found = self.nodes.pop(key, None) if isinstance(key, str) else self.processes.pop(key, None)
        if found is None:
            return
        del self._changed[key]
        self.number += 1
        self._gone[key] = self.number
        if len(self._gone) > _GONE_REMEMBERED:
            _, self._complete_since = self._gone.popitem(last=False)

    def begin(self) -> None:
        """Forget all: who reads it gets all anew."""
        self.nodes, self.processes = {}, {}
        self._changed.clear()
        self._gone.clear()
        self.number = self._complete_since = 0
        self._id += 1

    def take(self, changes: NodeChanges, now: int) -> None:
        """Do what another book's changes say, in this side's time (`now`, s)."""
        if changes.whole:
            known = {each.name for each in changes.nodes} | {each.pid for each in changes.processes}
            keys: tuple[str | int, ...] = (*self.nodes, *self.processes)
            for key in keys:
                if key not in known:
                    self.drop(key)
        shift = now - changes.now
        for node in changes.nodes:
            self.put(moved(node, shift))
        for process in changes.processes:
            before = self.processes.get(process.pid)
            since = moved_time(process.since, shift)
            # Its start is not later by the time that this message took.
            if before is not None and abs(before.since - since) < 60:
                since = before.since
            self.put(msgspec.structs.replace(process, since=since))
        for gone in changes.gone:
            self.drop(gone)

    def changes(self, book: int, since: int, now: int, may_send: Callable[[int], bool] = lambda _: True) -> NodeChanges:
        """Return what has changed since a number of this book; all if that is not known.

        Args:
            now: time of this side, s.
            may_send: whether there is room for so many further bytes; what finds none is in a later answer.
        """
        if self.why_not:
            return NodeChanges(0, 0, True, now, why_not=self.why_not)
        whole = book != self._id or not self._complete_since <= since <= self.number
        if whole:
            since = 0
        nodes: list[NodeState] = []
        processes: list[ProcessState] = []
        number = self.number
        for key, at in self._later(since):
            state = self.nodes[key] if isinstance(key, str) else self.processes[key]
            if not whole and not may_send(len(_encode(state))):
                number = at - 1
                break
            if isinstance(state, NodeState):
                nodes.append(state)
            else:
                processes.append(state)
        # Those that have come back meanwhile are among the others; what has no room yet, is gone later, too.
        gone = () if whole else tuple(k for k, at in self._gone.items() if since < at <= number and not self._has(k))
        return NodeChanges(self._id, number, whole, now, tuple(nodes), tuple(processes), gone)

    def _note(self, key: str | int) -> None:
        self.number += 1
        self._changed[key] = self.number
        self._changed.move_to_end(key)

    def _later(self, since: int) -> Iterable[tuple[str | int, int]]:
        """Return what has changed later than a number, oldest first."""
        later = []
        for key, at in reversed(self._changed.items()):
            if at <= since:
                break
            later.append((key, at))
        return reversed(later)

    def _has(self, key: str | int) -> bool:
        return key in self.nodes or key in self.processes


def moved(node: NodeState, shift: int) -> NodeState:
    """Return a node with its times so many seconds later."""
    ended = None if node.ended is None else moved_time(node.ended, shift)
    line = None if node.line is None else msgspec.structs.replace(node.line, at=moved_time(node.line.at, shift))
    return msgspec.structs.replace(node, ended=ended, line=line)
