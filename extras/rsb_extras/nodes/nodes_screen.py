"""The screen of nodes: a tree by machine and namespace with the faults first, and the page of one node."""

from __future__ import annotations

import asyncio
import re
import textwrap
import time
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.content import Content
from textual.screen import ModalScreen

from rsb_bridge.feature_api import EngineError, Wording
from rsb_console.feature_console import (
    ACTIONS,
    DIALOG,
    Dialog,
    FilteredScreen,
    FixedLines,
    Line,
    MainScreen,
    Prompt,
    RowFilter,
    ScrolledLines,
    SelectableList,
    fit,
    wrapped,
)
from rsb_extras.nodes import node_rows
from rsb_extras.nodes.node_data import OneNode
from rsb_extras.nodes.node_feed import NodeFeed
from rsb_extras.nodes.node_rows import FAULTS, NodeGroup

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_bridge.feature_api import LinkSnapshot, RouteSnapshot
    from rsb_console.feature_console import Console, OnNode
    from rsb_extras.nodes.node_data import NodeDetails, NodeState

_RENEWED_EVERY = 1.0  # s; the bridges ask each other as often
_FOLDED_FROM = 8  # nodes of a namespace without a fault. A round figure
_LABEL = 12
_WIDTH = 74  # cells, until the screen is laid out
ON_NODE = {action.id: action.on_node for action in ACTIONS if action.on_node is not None}
HELP = "   ".join(
    ("⏎ node, or fold", "/ filter", "f faults", "t its topics", *(each.label for each in ON_NODE.values()), "s side",
     "esc close")
)  # fmt: skip
_DETAIL_HELP = "t its topics   j k scroll   esc back"


class NodesScreenText(Wording):
    """Texts of the screen."""

    NONE = "no node"
    NO_MATCH = "no match"
    NO_PUBLISHER = "no node is known to publish {topic}"
    NO_TOPICS = "{node} publishes and hears nothing that is shown"


class NodeTable(SelectableList):
    """Machines, namespaces and nodes, one a line."""

    def __init__(self) -> None:
        super().__init__(id="nodes")
        self._lines: dict[str, Line] = {}

    def show(self, lines: dict[str, Line]) -> None:
        """Show lines by their keys."""
        self._lines = lines
        self.show_keys(list(lines))

    def line(self, index: int) -> Line:
        mark = "▌" if self.is_cursor(index) else " "
        return fit(((mark, "key"), *self._lines[self.keys[index]]), self.width)


class NodesScreen(FilteredScreen[str | None]):
    """The nodes of one side. It is closed with a filter for the table of topics, or None.

    Args:
        sides: names of links, and None for this side.
        side: the first one to show.
        topic: the topic whose publisher the cursor is to be on, by its name on that side, or empty.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "back", show=False),
        Binding("q", "dismiss(None)", show=False),
        Binding("enter", "open", show=False),
        Binding("f", "faults", show=False),
        Binding("t", "topics", show=False),
        Binding("s", "side", show=False),
        *(Binding(each.key, f"on_node({name!r})", show=False) for name, each in ON_NODE.items()),
    ]
    AUTO_FOCUS = "#nodes"
    DEFAULT_CSS = """
    #nodes-summary { background: $surface; }
    #nodes { height: 1fr; margin: 1 0; background: $surface; }
    """

    def __init__(self, console: Console, sides: list[str | None], side: str | None, topic: str = "") -> None:
        super().__init__(Prompt(""))
        self.console = console
        self.summary, self.table = FixedLines(id="nodes-summary"), NodeTable()
        self.feed = NodeFeed(console, side)
        self._sides, self._topic = sides, topic
        self._faults_only = False
        self._folds: dict[str, bool] = {}  # as the operator has left them
        self._wanted = ""  # node that the cursor is to be on
        self._groups: dict[str, NodeGroup] = {}

    def compose(self) -> ComposeResult:
        yield Dialog("Nodes", self.summary, self.table, self.prompt, keys=HELP, shape="-high")

    def on_mount(self) -> None:
        self.set_interval(_RENEWED_EVERY, self.renew)
        self.show()
        self._ask()

    def renew(self) -> None:
        """Ask again, unless an answer is still due, perhaps over a thin line."""
        if self._fetching.is_finished:
            self._ask()

    def _ask(self) -> None:
        self._fetching = self._fetch(self.feed)

    @work(exclusive=True, group="nodes")
    async def _fetch(self, feed: NodeFeed) -> None:
        if self._topic:
            topic, self._topic = self._topic, ""
            await self._want_publisher(topic)
        await feed.renew()
        self.show()

    async def _want_publisher(self, topic: str) -> None:
        """Have the cursor go to the node that publishes a topic."""
        if (found := await self._details(topic=topic)) is not None:
            if found.state is None:
                self.notify(NodesScreenText.NO_PUBLISHER(topic=topic), markup=False)
            else:
                self._wanted = found.state.name

    # --- what is shown

    def show(self) -> None:
        feed = self.feed
        parts = ["Nodes", feed.side_name, "faults only" if self._faults_only else ""]
        parts.append("" if self.pattern is None else f"/{self.pattern.text}")
        self.query_one(Dialog).border_title = Content(" ▸ ".join(filter(None, parts)))
        width = self.summary.size.width or _WIDTH
        self.summary.put([line for part, look in feed.summary for line in wrapped(part, width, look)])
        self.table.show(self._tree())
        if self._wanted in self.table.keys:
            self.table.move_to(self.table.keys.index(self._wanted))
            self._wanted = ""

    def _tree(self) -> dict[str, Line]:
        """Return the lines of the tree by their keys."""
        shown = [node for node in self.feed.book.nodes.values() if self._is_shown(node)]
        found = node_rows.groups(shown, self.feed.now)
        self._groups = {group.key: group for group in found}
        shared = node_rows.sharing(self.feed.book.nodes.values())
        machine, lines = "", dict[str, Line]()
        for group in found:
            if group.machine != machine:
                machine = group.machine
                lines[f"\n{machine}"] = ((machine, "head"),)
            folded = self._is_folded(group)
            about = f"  {len(group.nodes)} nodes" if folded else ""
            lines[group.key] = ((f" {'▸' if folded else '▾'} ", "dim"), (group.namespace, "strong"), (about, "dim"))
            if not folded:
                width = max(len(node_rows.short_name(node)) for node in group.nodes)
                for node in group.nodes:
                    name = f"{node_rows.short_name(node):<{min(width, 40)}}"
                    processes = self.feed.book.processes
                    line = node_rows.node_line(node, name, self.feed.now, processes, shared(node))
                    lines[node.name] = (("   ", ""), *line)
        if not lines and self.feed.is_known:
            filtered = self.pattern is not None or self._faults_only
            lines[""] = (((NodesScreenText.NO_MATCH if filtered else NodesScreenText.NONE)(), "dim"),)
        return lines

    def _is_shown(self, node: NodeState) -> bool:
        if self._faults_only and node_rows.health(node, self.feed.now) not in FAULTS:
            return False
        if self.pattern is None:
            return True
        line = "" if node.line is None else node.line.text
        return self.pattern.matches({"": f"{node.name} {node.machine} {node_rows.status(node, self.feed.now)} {line}"})

    def _is_folded(self, group: NodeGroup) -> bool:
        if self.pattern is not None or self._faults_only or any(node.name == self._wanted for node in group.nodes):
            return False
        at_first = node_rows.is_folded_at_first(group, self.feed.now, _FOLDED_FROM)
        return self._folds.get(group.key, at_first)

    # --- keys

    def action_open(self) -> None:
        """Open the page of a node, or fold or unfold a namespace."""
        key = self.table.cursor_key or ""
        if (group := self._groups.get(key)) is not None:
            self._folds[key] = not self._is_folded(group)
            self.show()
        elif key in self.feed.book.nodes:
            self._open(key)

    @work(exclusive=True, group="node")
    async def _open(self, name: str) -> None:
        details = await self._details(name)
        if details is None:
            return
        shared = 1 if details.state is None else node_rows.sharing(self.feed.book.nodes.values())(details.state)
        if await self.console.ask(NodeScreen(name, details, shared)):
            self._close_for(name, details)

    async def _details(self, node: str = "", topic: str = "") -> NodeDetails | None:
        engine = self.console.engine
        if engine is None:
            return None
        try:
            return await asyncio.wrap_future(engine.do(OneNode(self.feed.side, node, topic)))
        except EngineError as error:
            self.notify(str(error), severity="error", markup=False)
            return None

    def action_topics(self) -> None:
        """Show the topics of the node under the cursor in the table of topics."""
        if (name := self.table.cursor_key or "") in self.feed.book.nodes:
            self._show_topics(name)

    @work(exclusive=True, group="node")
    async def _show_topics(self, name: str) -> None:
        if (details := await self._details(name)) is not None:
            self._close_for(name, details)

    def _close_for(self, name: str, details: NodeDetails) -> None:
        topics = [each.name for each in (*details.publishes, *details.hears)]
        if topics:
            # Either side may have a name before them.
            side = self.feed.side
            robot = f"robot:^{re.escape(side)}$ " if side is not None and len(self._sides) > 2 else ""
            self.dismiss(f"{robot}topic:(?:{'|'.join(map(re.escape, topics))})$")
        else:
            self.notify(NodesScreenText.NO_TOPICS(node=name), markup=False)

    def action_on_node(self, name: str) -> None:
        """Do another feature's action on the node under the cursor."""
        node = self.table.cursor_key or ""
        if node in self.feed.book.nodes and self.table.is_seen():
            self._act_on_node(ON_NODE[name], node)

    @work(group=DIALOG)
    async def _act_on_node(self, action: OnNode, node: str) -> None:
        await action.run(self.console, self.feed.side or "", node)

    def on_selectable_list_chosen(self) -> None:
        self.action_open()

    def action_faults(self) -> None:
        self._faults_only = not self._faults_only
        self.show()

    def action_side(self) -> None:
        """Show the next side."""
        side = self._sides[(self._sides.index(self.feed.side) + 1) % len(self._sides)]
        self.feed = NodeFeed(self.console, side)
        self.show()
        self._ask()

    def action_back(self) -> None:
        """Drop what filters, or close."""
        if self.pattern is None and not self._faults_only:
            self.dismiss(None)
            return
        self.pattern, self._faults_only = None, False
        self.show()


class NodeScreen(ModalScreen[bool]):
    """All that is known of one node. It is closed with True to show its topics."""

    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss(False)", show=False),
        Binding("t", "dismiss(True)", show=False),
    ]
    AUTO_FOCUS = "#node"
    DEFAULT_CSS = "#node { height: 1fr; background: $surface; }"

    def __init__(self, name: str, details: NodeDetails, shared: int) -> None:
        super().__init__()
        self._node = name
        self._details, self._shared = details, shared
        self._read_at = time.monotonic()
        self.lines = ScrolledLines(id="node")

    def compose(self) -> ComposeResult:
        yield Dialog(self._node, self.lines, keys=_DETAIL_HELP, shape="-high")

    def on_mount(self) -> None:
        self.call_after_refresh(self.show)
        self.set_interval(_RENEWED_EVERY, self.show)

    def on_resize(self) -> None:
        self.show()

    def show(self) -> None:
        """Show what was read when the page was opened, with how long ago that is: all ages in it are of that time."""
        texts = node_rows.detail_lines(self._details, self._shared)
        if as_of := node_rows.read(time.monotonic() - self._read_at):
            texts.insert(0, ("read", as_of))
        width = max(20, (self.lines.size.width or 80) - _LABEL)
        self.lines.show(
            ((f"{'' if number else label:<{_LABEL}}", "dim"), (part, ""))
            for label, text in texts
            for number, part in enumerate(textwrap.wrap(text, width) or [""])
        )


async def show_nodes(screen: MainScreen) -> None:
    """Show the nodes of the side that publishes the topic under the cursor, or of the first link's other side."""
    console, route = screen.console, screen.topics.route
    sides: list[str | None] = [*(link.name for link in console.snapshot().links), None]
    side, topic = (sides[0], "") if route is None else _publishing_side(route)
    found = await console.ask(NodesScreen(console, sides, side, topic))
    if found is not None:
        _filter_topics(screen, found)


async def nodes_of_link(console: Console, link: LinkSnapshot) -> None:
    """Show the nodes at the other end of a link. For a node's topics, the list of links gives way to theirs."""
    sides: list[str | None] = [*(each.name for each in console.snapshot().links), None]
    nodes = NodesScreen(console, sides, link.name)
    found = await console.ask(nodes)
    if found is not None:
        *_, main, links = nodes.app.screen_stack
        if isinstance(main, MainScreen):
            _filter_topics(main, found)
            links.dismiss(None)


def _filter_topics(screen: MainScreen, pattern: str) -> None:
    screen.filtered = screen.topics
    screen.topics.pattern = RowFilter(pattern)
    screen.topics.relist()


def _publishing_side(route: RouteSnapshot) -> tuple[str | None, str]:
    """Return the side that publishes a topic, and its name there; of what is called, the side alone."""
    if route.spec.kind != "topic":
        return route.link, ""
    return (None, route.topic) if route.outgoing else (route.link, route.remote_topic)
