"""`rsb-console nodes`: the nodes of the other side, or of this one."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rsb_console.feature_console import FAILURE, UsageError, attached, done, failed, result
from rsb_extras.nodes import node_rows
from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import Nodes

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from rsb_bridge.feature_api import EngineApi
    from rsb_extras.nodes.node_data import NodeState, ProcessState

_LOOKS, _APART = 7, 0.5
"""Questions, and s between two: use of processors takes two readings, and lifecycle states one question each."""
_FOLDED_FROM = 8  # nodes of a namespace without a fault. A round figure


def nodes(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        link = None if arguments.here else _link(engine, arguments.link)
        book, at, now = NodeBook(), (0, 0), 0
        for look in range(_LOOKS):
            if look:
                time.sleep(_APART)
            found = result(engine.do(Nodes(link, *at)))
            if found.why_not:
                return failed(arguments, found.why_not, FAILURE)
            at, now = (found.book, found.number), found.now
            book.take(found, now)
    shown = [node for node in book.nodes.values() if arguments.all or not node.is_hidden]
    lines = list(_lines(book, shown, now, unfolded=arguments.all))
    title = ", ".join(filter(None, (node_rows.counts(shown, now), node_rows.as_of(found.age))))
    nodes = [_plain(node, book, now) for node in shown]
    return done(arguments, f"{link or 'this side'}: {title}", *lines, nodes=nodes, age=found.age)


def _link(engine: EngineApi, name: str) -> str:
    links = [each.name for each in engine.snapshot().links]
    if name and name not in links:
        raise UsageError(f"no link {name!r}: {', '.join(links) or 'none'}")
    if not name and len(links) != 1:
        raise UsageError(
            f"name a link: {', '.join(links)}" if links else "no link: --here lists the nodes of this side"
        )
    return name or links[0]


def _lines(book: NodeBook, shown: list[NodeState], now: int, *, unfolded: bool) -> Iterator[str]:
    machine = ""
    shared = node_rows.sharing(book.nodes.values())
    for group in node_rows.groups(shown, now):
        if group.machine != machine:
            machine = group.machine
            yield machine
        if not unfolded and node_rows.is_folded_at_first(group, now, _FOLDED_FROM):
            yield f"  {group.namespace}  {len(group.nodes)} nodes without a fault"
            continue
        yield f"  {group.namespace}"
        width = max(len(node_rows.short_name(node)) for node in group.nodes)
        for node in group.nodes:
            about = [node_rows.status(node, now), node_rows.figures(node, book.processes, shared(node))]
            if node.line is not None:
                about.append(node_rows.line_text(node.line, now))
            text = "; ".join(part for part in about if part)
            yield f"    {node_rows.short_name(node):<{width}}  {text}".rstrip()


def _plain(node: NodeState, book: NodeBook, now: int) -> dict[str, object]:
    """Return a node as plain data, with ages in s."""
    process = book.processes.get(node.pid)
    line = node.line
    return {
        "name": node.name,
        "machine": node.machine or None,
        "running": node.count,
        "health": node_rows.health(node, now).name.lower(),
        "lifecycle": node.lifecycle or None,
        "ended_ago": None if node.ended is None else now - node.ended,
        "ends": node.ends,
        "publishes": node.publishes,
        "hears": node.hears,
        "serves": node.serves,
        "pid": node.pid or None,
        "found_by": node.found_by or None,
        "process": None if process is None else _process(process, now),
        "line": None if line is None else {"level": line.level, "ago": now - line.at, "text": line.text},
    }


def _process(process: ProcessState, now: int) -> dict[str, object]:
    return {
        "name": process.name,
        "cpu": process.cpu,
        "memory_mb": process.memory,
        "threads": process.threads,
        "running_for": now - process.since,
    }
