"""The tree of nodes by machine and namespace, faults first, and the texts of each."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import State, plural
from rsb_bridge.model.verdict import duration
from rsb_console.feature_console import STATE_SIGN, SideText
from rsb_console.notation import formats
from rsb_extras.nodes.node_data import FoundBy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rsb_console.feature_console import Line
    from rsb_extras.nodes.node_data import LogLine, NameAndType, NodeDetails, NodeState, ProcessState

UNKNOWN_MACHINE = "a machine that is not known"
_AGED = 10.0
"""s without a word from a side that is asked each second, until that is said. A round figure."""
_FRESH = 300.0
"""s for which a line of a node counts. A round figure."""
_LEVELS = {30: "WARN", 40: "ERROR", 50: "FATAL"}
_MB = 10**6


class NodeHealth(IntEnum):
    """How well a node is, the worst first."""

    ENDED = 0
    ERROR = 1
    NOT_ACTIVE = 2
    WARN = 3
    WELL = 4
    HIDDEN = 5


FAULTS = frozenset({NodeHealth.ENDED, NodeHealth.ERROR, NodeHealth.NOT_ACTIVE, NodeHealth.WARN})
LOOK = {
    NodeHealth.ENDED: State.DOWN,
    NodeHealth.ERROR: State.STOPPED,
    NodeHealth.NOT_ACTIVE: State.WAITING,
    NodeHealth.WARN: State.STALE,
    NodeHealth.WELL: State.OK,
    NodeHealth.HIDDEN: State.RESTING,
}
"""A state of topics with a like sign and colour."""
_LOUD = frozenset(LOOK[each] for each in FAULTS)


class NodeGroup(NamedTuple):
    """The nodes of one namespace on one machine, the worst first."""

    machine: str
    namespace: str
    nodes: tuple[NodeState, ...]

    @property
    def key(self) -> str:
        return f"{self.machine}\n{self.namespace}"


def health(node: NodeState, now: float) -> NodeHealth:
    if node.ended is not None:
        return NodeHealth.ENDED
    if node.is_hidden:
        return NodeHealth.HIDDEN
    level = node.line.level if node.line is not None and now - node.line.at < _FRESH else 0
    if level >= 40:
        return NodeHealth.ERROR
    if node.lifecycle not in ("", "active"):
        return NodeHealth.NOT_ACTIVE
    return NodeHealth.WARN if level >= 30 else NodeHealth.WELL


def groups(nodes: Iterable[NodeState], now: float) -> list[NodeGroup]:
    """Return nodes by machine and namespace: the machines, and on each the namespaces, with the worst faults first."""
    found: dict[str, dict[str, list[tuple[NodeHealth, NodeState]]]] = {}
    for node in nodes:
        of_machine = found.setdefault(node.machine or UNKNOWN_MACHINE, {})
        of_machine.setdefault(node.name.rpartition("/")[0] or "/", []).append((health(node, now), node))

    def worst(of_namespace: list[tuple[NodeHealth, NodeState]]) -> NodeHealth:
        return min(each for each, _ in of_namespace)

    ordered = []
    for machine, of_machine in sorted(found.items(), key=lambda item: (min(map(worst, item[1].values())), item[0])):
        for namespace, each in sorted(of_machine.items(), key=lambda item: (worst(item[1]), item[0])):
            each.sort(key=lambda of: (of[0], of[1].name))
            ordered.append(NodeGroup(machine, namespace, tuple(node for _, node in each)))
    return ordered


def is_folded_at_first(group: NodeGroup, now: float, most: int) -> bool:
    """Whether a group with so many nodes or more has no fault that would be hidden if it is folded."""
    return len(group.nodes) >= most and not FAULTS & {health(node, now) for node in group.nodes}


def counts(nodes: Iterable[NodeState], now: float) -> str:
    """Say how many nodes there are, and how well: ``20 nodes, 1 ended, 2 with errors``."""
    shown = [node for node in nodes if not node.is_hidden]
    found = [health(node, now) for node in shown]
    running = sum(node.count for node in shown)
    parts = [f"{running} {plural(running, 'node')}"]
    words = {
        NodeHealth.ENDED: "ended",
        NodeHealth.ERROR: "with errors",
        NodeHealth.NOT_ACTIVE: "not active",
        NodeHealth.WARN: "with warnings",
    }
    parts += [f"{number} {word}" for each, word in words.items() if (number := found.count(each))]
    return ", ".join(parts)


def as_of(age: float) -> str:
    """Say how old nodes are, or an empty string while their side tells of them all the time."""
    return SideText.OLD(age=duration(age)) if age >= _AGED else ""


def read(age: float) -> str:
    """Say how old a page is that is not renewed, or an empty string at first."""
    return f"{duration(age)} ago: close this page and open it again" if age >= _AGED else ""


def short_name(node: NodeState) -> str:
    return node.name.rpartition("/")[2]


def status(node: NodeState, now: float) -> str:
    """Return a node's state in words, or an empty string if it just runs."""
    parts = []
    if node.ended is not None:
        parts.append(f"ended {_ago(node.ended, now)}")
    elif node.lifecycle:
        parts.append(node.lifecycle)
    if node.count > 1:
        parts.append(f"{node.count} of this name")
    if node.ends > (node.ended is not None):
        parts.append(f"ended {node.ends} {'time' if node.ends == 1 else 'times'} in an hour")
    return ", ".join(parts)


def figures(node: NodeState, processes: Mapping[int, ProcessState], shared: int = 1) -> str:
    """Return the figures of a node's process, or an empty string.

    Args:
        shared: number of nodes in that process.
    """
    process = processes.get(node.pid)
    if process is None or node.ended is not None:
        return ""
    threads = f"{process.threads} {plural(process.threads, 'thread')}"
    text = f"{process.cpu} %, {formats.byte_count(process.memory * _MB)}, {threads}"
    return text if shared == 1 else f"{text} with {formats.counted(shared - 1, 'other node')}"


def line_text(line: LogLine, now: float) -> str:
    return f"{_LEVELS.get(line.level, f'level {line.level}')} {_ago(line.at, now)}: {line.text}"


def node_line(node: NodeState, name: str, now: float, processes: Mapping[int, ProcessState], shared: int = 1) -> Line:
    """Return a node's line on a screen: state, name, figures and its last line of the log.

    Args:
        shared: number of nodes in its process.
    """
    state = LOOK[health(node, now)]
    last = "" if node.line is None else line_text(node.line, now)
    texts = [
        (status(node, now), "dim"),
        (figures(node, processes, shared), "dim"),
        (last, state.value if state in _LOUD else "dim"),
    ]
    if state in _LOUD:  # a narrow screen cuts the end
        texts[1:] = reversed(texts[1:])
    about = ((f"  {text}", look) for text, look in texts if text)
    return ((f"{STATE_SIGN[state]} ", state.value), (name, ""), *about)


def detail_lines(details: NodeDetails, shared: int = 1) -> list[tuple[str, str]]:
    """Return all that is known of a node, each line with its label, which is empty where one goes on."""
    node, process, now = details.state, details.process, details.now
    if node is None:
        return [("", "it is not known any more")]
    lines = [("state", status(node, now) or "runs")]
    if node.machine:
        lines.append(("machine", node.machine))
    if process is not None:
        by = ", found by its name" if node.found_by is FoundBy.NAME else ""
        lines.append(("process", f"{process.pid} ({process.name}), for {duration(now - process.since)}{by}"))
        lines.append(("", figures(node, {process.pid: process}, shared)))
    elif node.pid:
        lines.append(("process", str(node.pid)))
    elif node.ended is None:
        lines.append(("process", "not on the bridge's machine, or not known"))
    for label, names in (
        ("publishes", details.publishes),
        ("hears", details.hears),
        ("serves", details.serves),
        ("calls", details.calls),
    ):
        lines += _labelled(label, map(_name_text, names))
    if details.left_out:
        lines.append(("", f"{formats.counted(details.left_out, 'more name')} not shown"))
    return lines + _labelled("last lines", (line_text(each, now) for each in reversed(details.lines)))


def _labelled(label: str, texts: Iterable[str]) -> list[tuple[str, str]]:
    return [("" if number else label, text) for number, text in enumerate(texts)]


def _name_text(each: NameAndType) -> str:
    return f"{each.name}  {each.type}"


def _ago(at: float, now: float) -> str:
    return f"{duration(max(0.0, now - at))} ago"


def sharing(nodes: Iterable[NodeState]) -> Callable[[NodeState], int]:
    """Return a function that counts the running nodes in a node's process."""
    found: dict[int, int] = {}
    for node in nodes:
        if node.pid and node.ended is None:
            found[node.pid] = found.get(node.pid, 0) + 1
    return lambda node: found.get(node.pid, 1)
