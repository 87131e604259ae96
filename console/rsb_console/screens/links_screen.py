"""The links: one row for each robot on a server, a single row on a client."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

from textual import work
from textual.binding import Binding
from textual.screen import ModalScreen

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.model.wording import Wording
from rsb_console.notation import formats
from rsb_console.notation.glyphs import ACK_WORD, STATE_SIGN, STATE_WORD
from rsb_console.notation.link_fact import ADDED_FACTS, wrong_of
from rsb_console.screens.dialog import Dialog, is_meant
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.detail import acknowledged_by
from rsb_console.widgets.fault_pane import link_fault
from rsb_console.widgets.lines import FixedLines, Line, fit
from rsb_console.widgets.selectable_list import SelectableList
from rsb_console.widgets.topics import TopicsTable, state_order

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Iterator

    from textual import events
    from textual.app import App, ComposeResult

    from rsb_bridge.model.snapshot import LinkSnapshot, Snapshot
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen

HEADING = f" {'STATE':<8}{'NAME':<12}{'SINCE':>9}{'RTT':>8}{'CLOCK':>10}{'TOPICS':>7}{'RX':>9}{'TX':>9}  KEY"
_NAMED = 3  # links in a question; the others are counted
_AROUND = 7  # rows of the page of a link around its facts and its topics
LABEL = 15  # cells of a figure's name
CLIENT_KEYS = "a add a client   d remove it   "


class LinkText(Wording):
    """Texts of the details of a link."""

    BACK = "Let {links} connect again?"
    BACK_MEANS = "The key may have come late, so it is asked for. It was shut down; its topics cross again."
    NEXT_KEY_USED = "in use: the old key can be dropped"
    NEXT_KEY_UNUSED = "valid too; not in use yet"


class LinksTable(SelectableList):
    """One line for each link, the worst first."""

    sticky = 1

    def __init__(self) -> None:
        super().__init__(id="links")
        self._now: Snapshot | None = None
        self._links: dict[str, LinkSnapshot] = {}

    def show(self, snapshot: Snapshot) -> None:
        def badness(link: LinkSnapshot) -> tuple[float, str]:
            return state_order(link.state, acknowledged=link.acknowledged is not None), link.name

        self._now = snapshot
        self._links = {link.name: link for link in sorted(snapshot.links, key=badness)}
        self.show_keys(list(self._links))

    @property
    def selected(self) -> LinkSnapshot | None:
        return None if self.cursor_key is None else self._links.get(self.cursor_key)

    def line(self, index: int) -> Line:
        if index < self.sticky:
            return ((HEADING, "head"),)
        assert self._now is not None
        link = self._links[self.keys[index - self.sticky]]
        state = link.state
        name = fit(((f"{link.name:<12}", "strong"),), 12)
        topics = sum(route.link == link.name and route.spec.kind == "topic" for route in self._now.routes)
        figures = (
            f"{_span(link.rtt):>8}{_span(link.clock_offset):>10}{topics:>7}"
            f"{formats.byte_rate(link.rx_bytes_per_second):>9}{formats.byte_rate(link.tx_bytes_per_second):>9}"
        )
        shown = (f"{STATE_SIGN[state]} {STATE_WORD[state]:<6}", state.value)
        if link.acknowledged is not None:
            shown = (f"{ACK_WORD} {STATE_WORD[state]:<4}", "dim")
        return (
            ("▌" if self.is_cursor(index) else " ", "key"),
            shown,
            *name,
            (f"{formats.clock(self._now.time - link.since):>9}", "dim"),
            (figures, ""),
            (f"  {link.fingerprint}", "dim"),
        )


class LinkDetail(FixedLines):
    """The facts without a column: the reason why it is down, the key, the other side."""

    def __init__(self) -> None:
        super().__init__(id="link-detail")
        self._link: LinkSnapshot | None = None
        self._now = 0.0
        self._server = False

    def show(self, link: LinkSnapshot | None, now: float, *, server: bool) -> None:
        self._link, self._now, self._server = link, now, server
        self.put([] if link is None else list(_detail(link, now, self.size.width, server=server)))

    def on_resize(self) -> None:
        self.show(self._link, self._now, server=self._server)


def _detail(link: LinkSnapshot, now: float, width: int, *, server: bool) -> Iterator[Line]:
    if link.state is not State.OK or link.warning:
        parts = link_fault(link, server=server), formats.next_attempt(link), formats.waits(link, now)
        fault = "; ".join(filter(None, parts))
        yield from _paragraph("why", fault, "stale" if link.warning else link.state.value, width)
    for wrong in wrong_of(link):
        yield from _paragraph("!", wrong, State.STALE.value, width)
    if link.acknowledged is not None:
        yield (_label("known"), (acknowledged_by(link.acknowledged), "dim"))
    domain = "" if link.peer_domain is None else f"domain {link.peer_domain}"
    version = f"  rsb-console {link.peer_version}" if link.peer_version else ""
    yield (_label("peer"), (link.peer, ""), (f"  {domain}{version}", "dim"))
    if way := formats.via(link):
        yield (_label("way"), (way, ""))
    if link.encrypted:
        yield (_label("key"), (link.fingerprint, "strong"), (f"  {link.cipher}", "dim"))
        if link.next_fingerprint:
            taken = link.fingerprint == link.next_fingerprint
            which = (LinkText.NEXT_KEY_USED if taken else LinkText.NEXT_KEY_UNUSED)()
            yield (_label("next key"), (link.next_fingerprint, "strong"), (f"  {which}", "dim"))
    else:
        yield (_label("key"), (" NOT ENCRYPTED ", "alarm"))
    uncertain = "" if link.clock_uncertainty is None else f" ± {formats.span(link.clock_uncertainty)}"
    offset = "not known yet" if link.clock_offset is None else f"{_span(link.clock_offset)} against ours{uncertain}"
    yield (_label("its clock"), (offset, ""))
    if loss := formats.loss([link]):
        yield (_label("packets lost"), (loss, State.SLOW.value))
    for fact in ADDED_FACTS:
        for number, text in enumerate(fact.lines(link)):
            yield from _paragraph("" if number else fact.label, text, "", width)


def _paragraph(label: str, text: str, look: str, width: int) -> Iterator[Line]:
    for number, line in enumerate(textwrap.wrap(text, max(20, width - LABEL))):
        yield (_label("" if number else label), (line, look))


def _label(text: str) -> tuple[str, str]:
    return (f"  {text:<{LABEL - 2}}", "dim")


def _span(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    return f"-{formats.span(-seconds)}" if seconds < 0 else formats.span(seconds)


class LinkScreen(ModalScreen[None]):
    """One link, with its topics, live."""

    BINDINGS: ClassVar = [Binding("escape,q,enter", "dismiss", show=False)]

    def __init__(self, console: Console, name: str) -> None:
        super().__init__()
        self.console, self._link = console, name
        self.detail, self.topics = LinkDetail(), TopicsTable()

    def compose(self) -> ComposeResult:
        yield Dialog(f"Link {self._link}", self.detail, self.topics, keys="esc close")

    def on_mount(self) -> None:
        self.set_interval(1 / self.console.refresh_rate, self.show)
        self.show()

    def show(self) -> None:
        """Show the present state of the link; close the screen if the link is gone."""
        now = self.console.snapshot()
        link = next((link for link in now.links if link.name == self._link), None)
        if link is None:
            # Textual closes the screen on top, which may be the help.
            if self.is_active:
                self.dismiss()
            return
        self.detail.show(link, now.time, server=now.role == "server")
        # Patterns stand with their links; and if there are several, the table names the peer of each topic.
        routes = tuple(route for route in now.routes if route.link == self._link)
        self.topics.show(replace(now, routes=routes, links=(link,)))
        self.topics.explain("Nothing is bridged over this link.")
        room = self.size.height - self.detail.line_count - _AROUND
        self.topics.styles.height = min(self.topics.line_count + 1, max(3, room))


async def lets_back(console: Console, app: App[Any], links: Iterable[LinkSnapshot]) -> bool:
    """Whether to try links again; that lets back in what somebody has shut down, perhaps after the key was pressed."""
    names = [link.name for link in links if link.cause == LinkCause.SHUT_DOWN]
    title = LinkText.BACK(links=join_first(names, _NAMED))
    return not names or await is_meant(console, app, title, LinkText.BACK_MEANS(), "Try again")


class LinksScreen(ModalScreen[None]):
    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss", show=False),
        Binding("enter", "open", show=False),
        Binding("r", "retry", show=False),
        Binding("i", "acknowledge", show=False),
        Binding("a", "add_client", show=False),
        Binding("d", "remove_client", show=False),
    ]

    def __init__(self, console: Console) -> None:
        super().__init__()
        self.console = console
        self.table, self.detail = LinksTable(), LinkDetail()

    def compose(self) -> ComposeResult:
        clients = CLIENT_KEYS if self._is_server else ""
        keys = "" if self.console.readonly else f"{clients}r try again now   i acknowledge   "
        yield Dialog("Links", self.table, self.detail, keys=f"⏎ detail   {keys}esc close")

    def on_mount(self) -> None:
        self.set_interval(1 / self.console.refresh_rate, self.show)
        self.show()

    def show(self) -> None:
        self.table.show(self.console.snapshot())
        self.table.styles.height = min(self.table.line_count, 12)
        self.on_selectable_list_cursor_moved()

    def on_selectable_list_cursor_moved(self) -> None:
        self.detail.show(self.table.selected, self.console.snapshot().time, server=self._is_server)

    def on_key(self, event: events.Key) -> None:
        """Do what one of the operator's own keys does to the link under the cursor."""
        preferences, link = self.console.preferences, self.table.selected
        own = (each for each in preferences.actions if each.on_link is not None)
        action = next((each for each in own if event.key in preferences.keys(each)), None)
        if action is None or action.on_link is None or link is None or (action.changes and self.console.readonly):
            return
        event.stop()
        if self.table.is_seen():
            self._act(action.on_link, link)

    @work(group=DIALOG)
    async def _act(self, on_link: Callable[[Any, LinkSnapshot], Awaitable[None]], link: LinkSnapshot) -> None:
        await on_link(self.console, link)

    def action_open(self) -> None:
        if self.table.selected is not None:
            self.app.push_screen(LinkScreen(self.console, self.table.selected.name))

    def on_selectable_list_chosen(self) -> None:
        self.action_open()

    @work(group=DIALOG)
    async def action_retry(self) -> None:
        link, engine = self.table.selected, self.console.engine
        if link is None or engine is None or self.console.readonly or not self.table.is_seen():
            return
        if await lets_back(self.console, self.app, [link]):
            lets_in = self._is_server and link.cause == LinkCause.SHUT_DOWN
            done = "it may come back" if lets_in else "trying again"
            await self.console.command(engine.retry(link.name), f"{link.name}: {done}")

    @work
    async def action_acknowledge(self) -> None:
        """Acknowledge the fault of the link under the cursor, or undo that."""
        link, engine = self.table.selected, self.console.engine
        if link is not None and engine is not None and not self.console.readonly and self.table.is_seen():
            seen = link.state, link.cause
            await self.console.command(engine.acknowledge("", link.acknowledged is None, link=link.name, seen=seen))

    @property
    def _is_server(self) -> bool:
        return self.console.snapshot().role == "server"

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action in ("add_client", "remove_client"):
            return self._is_server and not self.console.readonly
        return super().check_action(action, parameters)

    @work(group=DIALOG)
    async def action_add_client(self) -> None:
        from rsb_console.screens.clients_screen import add_client  # noqa: PLC0415 -- seldom needed

        await add_client(self.console)

    @work(group=DIALOG)
    async def action_remove_client(self) -> None:
        from rsb_console.screens.clients_screen import remove_client  # noqa: PLC0415 -- seldom needed

        link = self.table.selected
        if link is not None:
            await remove_client(self.console, link.name)


async def show_links(screen: MainScreen) -> None:
    await screen.console.ask(LinksScreen(screen.console))
