"""Keeps the book of this side's nodes.

Names and endpoints are read when the graph has changed, a second's share at a time; at rest, nothing is. Processes,
lifecycle states and, unless the session asks for it, /rosout are read only while somebody looks.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

from rsb_bridge.feature_api import Qos, RosError, TopicSpec
from rsb_bridge.ros.ros_interface import NodeEnds
from rsb_extras.nodes import HEAR_ROSOUT
from rsb_extras.nodes.graph_nodes import PARTICIPANT, ROSOUT, GraphNode, GraphNodes, node_names, read_nodes
from rsb_extras.nodes.lifecycle_states import SERVICE, TYPE, LifecycleStates
from rsb_extras.nodes.log_messages import TYPE as LOG_TYPE
from rsb_extras.nodes.log_messages import Logged, read_log
from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import (
    KEPT_FOR,
    MOST_LINES,
    MOST_NAMES,
    MOST_NODES,
    FoundBy,
    LogLine,
    NameAndType,
    NodeDetails,
    NodeState,
    ProcessState,
)
from rsb_extras.nodes.node_processes import NodeProcesses

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping, Sequence

    from rsb_bridge.feature_api import Context, Endpoint, RawMessage
    from rsb_bridge.ros.ros_interface import Subscription

LOOKED_FOR = 5.0
"""s for which a question counts as a look. Consoles and peers ask each second."""
_READ_AT_ONCE = 50
"""Nodes read in a second, new ones first: 10 ms on a thread. A round figure."""
_FIGURES_EVERY = 2.0
_NAMES_EVERY = 10.0  # s between two searches for processes by name: each reads all command lines
_MOST_ENDED = 200
_MOST_WAITING = 1000  # lines of /rosout between two turns of the loop
_MOST_PARTS = 16
"""Parts of a logger's name in which its node is looked for: the name is any text."""
_LINES = Qos(durability="transient_local", depth=1000)
"""As nodes publish /rosout: who begins to look gets what they have kept, of the last 10 s."""
_OF_EVERY_NODE = frozenset(
    {"describe_parameters", "get_parameter_types", "get_parameters", "get_type_description", "list_parameters",
     "set_parameters", "set_parameters_atomically"}
)  # fmt: skip
_TOPICS_OF_EVERY_NODE = frozenset({"/parameter_events", ROSOUT})
_CPU_STEP, _CPU_SHARE = 3, 0.2
_MEMORY_STEP, _MEMORY_SHARE = 2, 0.05
"""Figures that differ by less than a step, in percent or MB, or by less than a share are no news."""


class EndedNode(NamedTuple):
    """A node that has ended, when (s), and its last line or an empty string."""

    node: str
    at: float
    line: str


@dataclass
class _Node:
    """What is known of a node.

    Attributes:
        ends: its names, the last ones that were seen.
        ended: when it ended, or None while it runs.
        endings: times at which it has ended, within the last hour.
    """

    ends: NodeEnds | None = None
    participants: frozenset[bytes] = frozenset()
    machine: str = ""
    pid: int = 0
    found_by: FoundBy = FoundBy.NOT
    count: int = 1
    lifecycle: str = ""
    ended: float | None = None
    endings: deque[float] = field(default_factory=lambda: deque(maxlen=100))
    lines: deque[LogLine] = field(default_factory=lambda: deque(maxlen=MOST_LINES))

    def state(self, name: str) -> NodeState:
        publishes, hears, serves, _ = (0, 0, 0, 0) if self.ends is None else map(len, map(_of_its_own, self.ends))
        runs = self.ended is None
        return NodeState(
            name=name,
            machine=self.machine,
            pid=self.pid,
            found_by=self.found_by,
            count=self.count if runs else 0,
            publishes=publishes,
            hears=hears,
            serves=serves,
            lifecycle=self.lifecycle if runs else "",
            ends=len(self.endings),
            ended=None if self.ended is None else round(self.ended),
            line=self.lines[-1] if self.lines else None,
        )


class _Read(NamedTuple):
    """What a thread has read."""

    names: Counter[str]
    nodes: GraphNodes
    found: Mapping[bytes, tuple[str, int, bool]]  # machine, pid, and whether it has ended, by participant
    by_name: Mapping[str, int]


class NodeWatch:
    """The nodes of this side's domain. All links of an engine share it.

    Attributes:
        book: all that is shown of them.
        endings: how many have ended so far.
    """

    def __init__(self, context: Context) -> None:
        self.endings = 0
        self.book: Final = NodeBook(context.wall_ns() >> 16)
        self._context = context
        self._nodes: dict[str, _Node] = {}
        self._publishers: dict[str, set[str]] = {}  # nodes by topics, those that have ended, too
        self._changes = -1
        self._to_read: dict[str, None] = {}
        self._reading: asyncio.Task[None] | None = None
        self._first = asyncio.Event()
        self._looked_until = float("-inf")
        self._processes: NodeProcesses | None = None
        self._gone: set[bytes] = set()  # participants whose processes have ended, though DDS may list them
        self._suspects: set[bytes] = set()  # those of silent publishers
        self._figures_at = self._by_name_at = float("-inf")
        self._lifecycle = LifecycleStates(context, self._state_told)
        self._logs: Subscription | None = None
        self._log_publishers: dict[bytes, str] = {}
        self._log_hash = ""
        self._waiting: deque[tuple[bytes, Logged]] = deque(maxlen=_MOST_WAITING)
        self._is_to_take = False  # whether the loop will take them

    # --- looks

    @property
    def is_looked_at(self) -> bool:
        return self._context.now() < self._looked_until

    def look(self) -> None:
        """Note that somebody looks."""
        self._looked_until = self._context.now() + LOOKED_FOR

    async def ready(self) -> None:
        """Wait for the first reading of the graph."""
        await self._first.wait()

    def details(self, node: str, topic: str = "") -> NodeDetails:
        """Return all that is known of a node, by its name, or of the one that publishes or has published a topic."""
        now = round(self._context.now())
        name = node or self._publisher_of(topic)
        if (known := self._nodes.get(name)) is None:
            return NodeDetails(now)
        lists = [_of_its_own(each) for each in (known.ends if known.ends is not None else NodeEnds())]
        publishes, hears, serves, calls = (names[:MOST_NAMES] for names in lists)
        left_out = sum(max(0, len(names) - MOST_NAMES) for names in lists)
        process = self.book.processes.get(known.pid)
        return NodeDetails(
            now, known.state(name), process, publishes, hears, serves, calls, tuple(known.lines), left_out
        )

    def ended_publisher(self, topic: str) -> EndedNode | None:
        """Return the node that published a topic and ended last, or None if none has."""
        name = self._publisher_of(topic)
        known = self._nodes.get(name)
        return None if known is None or known.ended is None else self._ended(name, known, known.ended)

    def ended_node(self, endpoints: Sequence[Endpoint]) -> EndedNode | None:
        """Return the node of endpoints that DDS still lists, though all their processes have ended, or None.

        An end that is not known yet is found within a second or two, on a thread.
        """
        if not endpoints:
            return None
        participants = {each.gid[:PARTICIPANT] for each in endpoints}
        if not participants <= self._gone:
            self._suspects |= participants
            return None
        name = endpoints[0].node
        known = self._nodes.get(name)
        return None if known is None or known.ended is None else self._ended(name, known, known.ended)

    # --- once a second

    def tick(self, changes: int) -> None:
        """Do the regular work.

        Args:
            changes: number of changes of the graph so far.
        """
        if changes != self._changes:
            self._changes = changes
            self._to_read |= dict.fromkeys(self._nodes)
            self._soon(self._read)
        elif self._to_read or (self.is_looked_at and self._context.now() - self._figures_at >= _FIGURES_EVERY):
            self._soon(self._read)
        elif self._suspects:
            self._soon(self._find_ends)
        self._forget()
        if self.is_looked_at:
            self._lifecycle.ask(self._managed())
        else:
            self._lifecycle.close()
            for name, each in self._nodes.items():
                if each.lifecycle:
                    self._state_told(name, "")
        self._hear()

    def close(self) -> None:
        """End: the bridge does."""
        self._lifecycle.close()
        if self._logs is not None:
            self._logs.close()

    # --- the graph and its processes

    def _soon(self, work: Callable[[], Coroutine[None, None, None]]) -> None:
        if self._reading is None or self._reading.done():
            self._reading = self._context.loop.create_task(work())

    async def _find_ends(self) -> None:
        """Look whether the processes of silent publishers have ended."""
        suspects, self._suspects = self._suspects, set()
        if (processes := self._processes) is None:
            return
        self._gone |= await asyncio.to_thread(lambda: {each for each in suspects if processes.has_ended(each)})
        for name, known in tuple(self._nodes.items()):
            if known.participants and known.participants <= self._gone:
                self._end(name, known, self._context.now())

    async def _read(self) -> None:
        context = self._context
        own, changes = context.announcements.gid, self._changes
        if self._processes is None and own:
            self._processes = NodeProcesses(own)
        looked = self.is_looked_at
        known = {name: each.participants for name, each in self._nodes.items()}
        unfound = set()
        if looked and context.now() - self._by_name_at >= _NAMES_EVERY:
            unfound = {name for name, each in self._nodes.items() if not each.machine and each.ended is None}
            self._by_name_at = context.now() if unfound else self._by_name_at
        with contextlib.suppress(RosError):  # the node has stopped
            # One that has ended and is listed may have come back.
            to_read = sorted(self._to_read, key=lambda name: self._nodes[name].ended is None)
            read = await asyncio.to_thread(self._read_graph, known, to_read, unfound)
            self._take(read)
            if changes != self._changes:  # meanwhile, so that what was just read may be old
                self._to_read |= dict.fromkeys(self._nodes)
            if looked:
                self._figures_at = context.now()
                pids = {each.pid for each in self._nodes.values() if each.pid and each.ended is None}
                if self._processes is not None:
                    now = context.now()
                    self._take_figures(pids, await asyncio.to_thread(_figures, self._processes, pids, now))
            self._first.set()

    def _read_graph(self, known: Mapping[str, frozenset[bytes]], to_read: list[str], unfound: set[str]) -> _Read:
        """Read names and some nodes; on a thread."""
        ros, processes = self._context.ros, self._processes
        names = node_names(ros)
        new = [name for name in names if name not in known]
        due = [*new, *(name for name in to_read if name in names)][:_READ_AT_ONCE]
        nodes = read_nodes(ros, due) if due else GraphNodes({}, {}, "")
        participants = {p for each in nodes.nodes.values() for p in each.participants}
        participants.update(*known.values())
        found: dict[bytes, tuple[str, int, bool]] = {}
        if processes is not None:
            for each in participants:
                found[each] = processes.machine_of(each), processes.pid_of(each), processes.has_ended(each)
        by_name: dict[str, int] = {}
        if unfound and processes is not None:
            by_name = dict.fromkeys(unfound, 0) | processes.pid_by_name(unfound)
        return _Read(names, nodes, found, by_name)

    def _take(self, read: _Read) -> None:
        now = self._context.now()
        gone = {each for each, (_, _, ended) in read.found.items() if ended}
        self._gone = gone if len(self._gone) > 4 * MOST_NODES else self._gone | gone
        self._log_publishers |= read.nodes.log_publishers
        if len(self._log_publishers) > 2 * MOST_NODES:
            self._log_publishers = dict(read.nodes.log_publishers)
        self._log_hash = read.nodes.log_hash or self._log_hash
        for name in read.names:
            if name not in self._nodes and name not in read.nodes.nodes:
                self._nodes[name] = _Node()
                self._to_read[name] = None
        for name, node in read.nodes.nodes.items():
            self._to_read.pop(name, None)
            self._take_node(name, node, read, now)
        for name, known in tuple(self._nodes.items()):
            if name not in read.names:
                self._to_read.pop(name, None)
                self._end(name, known, now)
            else:
                self._take_process(name, known, read, now)
        for name, pid in read.by_name.items():
            if (known_ := self._nodes.get(name)) is not None and known_.ended is None and not known_.machine:
                known_.pid, known_.found_by = pid, FoundBy.NAME if pid else FoundBy.NOT
                self._show(name)

    def _take_node(self, name: str, node: GraphNode, read: _Read, now: float) -> None:
        known = self._nodes.setdefault(name, _Node())
        living = {each for each in node.participants if not read.found.get(each, ("", 0, False))[2]}
        if node.participants and not living:
            return  # it has ended, and DDS lists it for a while
        if known.ended is None and known.participants and not known.participants & living:
            self._end(name, known, now)  # another one has taken its place meanwhile
            known = self._nodes.setdefault(name, _Node())  # a tool is forgotten
        if known.ended is not None:
            known.ended, known.lifecycle = None, ""
            known.pid, known.found_by = 0, FoundBy.NOT
        if any(node.ends) or known.ends is None:
            self._index(name, known.ends, node.ends)
            known.ends = node.ends
        known.participants = frozenset(living)
        # Without those that have ended, and that DDS lists for a while.
        known.count = max(1, read.names[name] - len(node.participants) + len(living))

    def _take_process(self, name: str, known: _Node, read: _Read, now: float) -> None:
        found = [read.found[each] for each in known.participants if each in read.found]
        if found and all(ended for _, _, ended in found):
            self._end(name, known, now)
            return
        alive = [each for each in found if not each[2]]
        if alive:
            known.machine = next((machine for machine, _, _ in alive if machine), "")
            if pid := next((pid for _, pid, _ in alive if pid), 0):
                known.pid, known.found_by = pid, FoundBy.GUID
            elif known.found_by is not FoundBy.NAME:  # whose end its figures show
                known.pid, known.found_by = 0, FoundBy.NOT
        if known.ended is None:
            self._show(name)

    def _end(self, name: str, known: _Node, now: float) -> None:
        if known.ended is not None:
            return
        known.ended, known.lifecycle = now, ""
        known.endings.append(now)
        self.endings += 1
        if name.rpartition("/")[2].startswith("_"):  # a tool
            self._drop(name)
        else:
            self._show(name)

    def _take_figures(self, pids: set[int], found: Mapping[int, ProcessState]) -> None:
        for pid, now in found.items():
            before = self.book.processes.get(pid)
            if before is None or _differ(before, now):
                since = now.since if before is None or abs(before.since - now.since) > 1 else before.since
                self.book.put(msgspec.structs.replace(now, since=since))
        for pid in [pid for pid in self.book.processes if pid not in pids or pid not in found]:
            self.book.drop(pid)
        for name, each in self._nodes.items():
            if each.found_by is FoundBy.NAME and each.ended is None and each.pid in pids and each.pid not in found:
                each.pid, each.found_by = 0, FoundBy.NOT
                self._show(name)

    def _forget(self) -> None:
        """Forget nodes that have ended long ago, or before many others."""
        oldest = self._context.now() - KEPT_FOR
        ended = sorted((each.ended, name) for name, each in self._nodes.items() if each.ended is not None)
        for at, name in ended[: max(0, len(ended) - _MOST_ENDED)] + [each for each in ended if each[0] < oldest]:
            if name in self._nodes and at is not None:
                self._drop(name)
        for name, each in self._nodes.items():
            if each.endings and each.endings[0] < oldest:
                while each.endings and each.endings[0] < oldest:
                    each.endings.popleft()
                self._show(name)

    def _drop(self, name: str) -> None:
        self._index(name, self._nodes.pop(name).ends, None)
        self._to_read.pop(name, None)
        self.book.drop(name)

    def _index(self, name: str, before: NodeEnds | None, now: NodeEnds | None) -> None:
        """Note which topics a node publishes, and no longer those that it did before."""
        for topic in before.publishes if before is not None else ():
            self._publishers[topic].discard(name)
            if not self._publishers[topic]:
                del self._publishers[topic]
        for topic in now.publishes if now is not None else ():
            self._publishers.setdefault(topic, set()).add(name)

    def _show(self, name: str) -> None:
        self.book.put(self._nodes[name].state(name))

    # --- its states and lines

    def _managed(self) -> list[str]:
        return [
            name
            for name, each in self._nodes.items()
            if each.ended is None and each.ends is not None and TYPE in each.ends.serves.get(name + SERVICE, ())
        ]

    def _state_told(self, name: str, state: str) -> None:
        if (known := self._nodes.get(name)) is not None and known.lifecycle != state:
            known.lifecycle = state
            self._show(name)

    def _hear(self) -> None:
        """Subscribe to /rosout while that is wanted."""
        context = self._context
        wanted = self.is_looked_at or HEAR_ROSOUT.of(context.session)
        if not wanted and self._logs is not None:
            self._logs.close()
            self._logs = None
        elif wanted and self._logs is None and self._log_hash:
            spec = TopicSpec(ROSOUT, LOG_TYPE, self._log_hash, _LINES)
            with contextlib.suppress(RosError):  # in a second again
                self._logs = context.ros.subscribe(spec, self._logged, "nodes", self._logs_failed)

    def _logs_failed(self, _: RosError) -> None:  # on the ROS thread
        def forget() -> None:
            self._logs = None

        self._context.call(forget)

    def _logged(self, batch: Sequence[RawMessage]) -> None:  # on the ROS thread
        lines = [(each.gid, line) for each in batch if (line := read_log(each.payload)) is not None]
        if lines:
            self._waiting.extend(lines)  # before the look at what the loop does: it may end with taking them
            if not self._is_to_take:
                self._is_to_take = True
                self._context.call(self._take_lines)

    def _take_lines(self) -> None:
        self._is_to_take = False
        now = round(self._context.now())
        changed = set()
        while self._waiting:
            gid, logged = self._waiting.popleft()
            name = self._log_publishers.get(gid) or self._by_logger(logged.logger)
            known = self._nodes.get(name)
            if known is None:
                continue
            line = LogLine(logged.level, now, logged.text)
            if known.lines and (known.lines[-1].level, known.lines[-1].text) == (line.level, line.text):
                known.lines.pop()  # repeated
            known.lines.append(line)
            changed.add(name)
        for name in changed:
            self._show(name)

    def _by_logger(self, logger: str) -> str:
        """Return the node of a logger, ``namespace.node`` or a child of it, or an empty string."""
        parts = logger[:1000].split(".", _MOST_PARTS)[:_MOST_PARTS]
        names = ("/" + "/".join(parts[:end]) for end in range(len(parts), 0, -1))
        return next((name for name in names if name in self._nodes), "")

    def _publisher_of(self, topic: str) -> str:
        """Return a node that publishes a topic, else the one that did and ended last, or an empty string."""
        found = [(self._nodes[name], name) for name in self._publishers.get(topic, ())]
        latest = max(((node.ended is None, node.ended or 0.0, name) for node, name in found), default=None)
        return "" if latest is None else latest[2]

    def _ended(self, name: str, known: _Node, at: float) -> EndedNode:
        return EndedNode(name, at, known.lines[-1].text if known.lines else "")


def _figures(processes: NodeProcesses, pids: set[int], now: float) -> dict[int, ProcessState]:
    return {pid: found for pid in pids if (found := processes.figures(pid, now)) is not None}


def _differ(before: ProcessState, now: ProcessState) -> bool:
    """Whether figures differ so much that it is news."""
    return (
        before.threads != now.threads
        or before.name != now.name
        or abs(before.cpu - now.cpu) >= max(_CPU_STEP, _CPU_SHARE * before.cpu)
        or abs(before.memory - now.memory) >= max(_MEMORY_STEP, _MEMORY_SHARE * before.memory)
    )


def _of_its_own(names: Mapping[str, Sequence[str]]) -> tuple[NameAndType, ...]:
    """Return names by the alphabet, without those that every node has."""
    return tuple(
        NameAndType(name, types[0] if types else "")
        for name, types in sorted(names.items())
        if name not in _TOPICS_OF_EVERY_NODE and name.rpartition("/")[2] not in _OF_EVERY_NODE
    )
