"""The main screen: topics, detail and log. Changes of the bridge are in `rsb_console.operations`."""

from __future__ import annotations

from functools import partial
from inspect import iscoroutinefunction
from typing import TYPE_CHECKING

from textual import events, on
from textual.containers import Horizontal
from textual.screen import Screen

from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.wording import Wording
from rsb_console.actions.action import NAMESPACE, FooterEntry, Group, call_of
from rsb_console.actions.all_actions import BY_ID, bindings
from rsb_console.terminal.input_queue import SEEN_AFTER
from rsb_console.widgets.bars import BarState, KeyBar, KeyEntry, StatusBar, state_counts, warning_count
from rsb_console.widgets.detail import DetailPane
from rsb_console.widgets.fault_pane import Fault, FaultLines, MoreKeys, faults_of
from rsb_console.widgets.filter import Prompt
from rsb_console.widgets.log import LogPane
from rsb_console.widgets.topics import FAULTS, TopicsTable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import Event, Snapshot
    from rsb_console.actions.action import Action
    from rsb_console.console_api import Console
    from rsb_console.widgets.lines import Line
    from rsb_console.widgets.selectable_list import SelectableList

MODES = ("-detail", "-log", "-table")  # classes that give one pane the screen


class EmptyTable(Wording):
    """Texts of a table without topics."""

    NO_SESSION = "No session. {opens} opens one, {new} writes a new one, {welcome} shows all ways to begin."
    NO_SESSION_READ_ONLY = "No session. Start the console with one: rsb-console --readonly SESSION"


class MainText(Wording):
    """Notes of the main screen."""

    LATE = "YOUR LINE IS {late:.0f} s LATE: {key} sends less"
    READ_ONLY = "read-only: nothing can be changed here"


class Explanations:
    """Explains why the bridge does not run or the table is empty, and which key to press."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def key(self, action: str) -> str:
        return self._console.key_labels(BY_ID[action])[0]

    def bar(self, snapshot: Snapshot, frozen_since: float | None) -> BarState:
        """Return what the status bar shows in addition to the snapshot."""
        console, engine = self._console, self._console.engine
        session = "" if console.path is None else console.path.stem
        way_on = "" if snapshot.running or engine is None else self._way_on()
        note = console.note
        if not note and engine is not None and engine.unreachable:
            note = f"✗ NOT ATTACHED: {engine.unreachable}"
        attached = bool(console.attached_to)
        seconds = console.writer.late
        late = MainText.LATE(late=max(1.0, seconds), key=self.key("slower")) if seconds > SEEN_AFTER else ""
        rate, readonly = console.refresh_rate, console.readonly
        return BarState(session, rate, frozen_since, readonly, note, way_on, attached=attached, late=late)

    def faults(self, snapshot: Snapshot, events: Sequence[Event]) -> list[Fault]:
        """Return the reason why the engine does not run, if it has logged one."""
        if snapshot.running or self._console.engine is None:
            return []
        errors = (event for event in reversed(events) if event.level is Level.ERROR)
        cause = next((event.text for event in errors if event.code.startswith("engine.")), "")
        return [Fault("✗", State.DOWN.value, "", snapshot.name, cause, of_link=True)] if cause else []

    def _way_on(self) -> str:
        """Return the key that starts the engine again; the banner has the reason why it does not run."""
        stays = self._console.readonly or self._console.attached_to
        return "" if stays else f"{self.key('restart')} starts it again"

    def why_empty(self, snapshot: Snapshot) -> str:
        """Return the reason why there are no topics, and the key to press."""
        console = self._console
        if console.engine is None and console.readonly:
            return EmptyTable.NO_SESSION_READ_ONLY()
        if console.engine is None:
            opens, new, welcome = (self.key(action) for action in ("sessions", "new_session", "welcome"))
            return EmptyTable.NO_SESSION(opens=opens, new=new, welcome=welcome)
        if not snapshot.running:
            return "" if console.note else f"The bridge does not run. {self._way_on()}".rstrip()
        if console.readonly:
            return "No topics yet."
        theirs = "They come with the clients; " if snapshot.role == "server" else ""
        return f"No topics yet. {theirs}{self.key('add_topic')} adds one."


class Panes(Horizontal):
    """Topics and detail, side by side."""

    BLANK = True  # the panes cover it: nothing to draw


class MainScreen(Screen[None]):
    """Topics, detail and log.

    Textual looks up an action's handler on the screen, as ``action_<id>``: each does the registry's action.
    """

    BINDINGS = bindings(Group.VIEW, Group.OPERATE, Group.SESSION)
    BLANK = True  # as its `Panes`
    AUTO_FOCUS = "#topics"
    # From 110 columns on, the table has `topics.WIDE` cells with the details in sight.
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (110, "-wide")]  # noqa: RUF012 -- Textual declares it without ClassVar
    VERTICAL_BREAKPOINTS = [(0, "-tiny"), (14, "-short"), (30, "-tall")]  # noqa: RUF012 -- as above

    def __init__(self, console: Console) -> None:
        super().__init__()
        self.console = console
        self.explanations = Explanations(console)
        self._actions = {action.id: action for action in console.preferences.actions}
        for action in self._actions.values():
            if action.run is not None:
                setattr(self, f"action_{action.id}", partial(self.act, action))
        self.status, self.faults, self.prompt, self.key_bar = StatusBar(), FaultLines(), Prompt(), KeyBar()
        self.topics, self.detail, self.log_pane = TopicsTable(), DetailPane(), LogPane()
        self.filtered: TopicsTable | LogPane = self.topics  # by the prompt
        self.frozen_since: float | None = None  # s since the epoch, or None while the view is live
        self._held: list[Event] = []
        self._keys_shown: list[KeyEntry] | None = None
        self.topic_counts: Line = ()  # of faults
        self.link_counts: Line = ()
        self.is_unsaved = False

    def act(self, action: Action) -> None:
        """Do an action; one that waits goes on as a worker."""
        assert action.run is not None
        if action.changes and action.needs_topic:
            if not (action.stops is not None and action.stops(self)) and not self.topics.is_seen():
                return
            self.topics.hold()  # the next key is for the same topic, wherever its new state puts it
        call = call_of(action.run, self)
        if iscoroutinefunction(call.func):
            # Another choice of a session replaces one that waits in a dialog.
            self.run_worker(call, group=action.group, exclusive=action.group is Group.SESSION)
        else:
            call()

    def compose(self) -> ComposeResult:
        yield self.status
        yield self.faults
        with Panes(id="panes"):
            yield self.topics
            yield self.detail
        yield self.log_pane
        yield self.prompt
        yield self.key_bar

    def on_mount(self) -> None:
        for pane in (self.topics, self.detail, self.log_pane):
            pane.add_class("pane")
        self.topics.wanted_columns = self.console.preferences.columns
        # Their titles, which would come with the first snapshot only.
        self.topics.relist()
        self.log_pane.relist()

    # -- what is shown ------------------------------------------------------------------------------------------------

    def show(self, snapshot: Snapshot, new_events: Sequence[Event]) -> None:
        """Show the engine's state; while frozen, update only the lines at the top."""
        self._held += new_events  # one of them may say why the engine has ended
        explanations, key = self.explanations, self.explanations.key
        self.status.show(snapshot, explanations.bar(snapshot, self.frozen_since))
        self.is_unsaved = snapshot.unsaved
        self.topic_counts = state_counts(snapshot.routes, FAULTS)
        self.link_counts = (*state_counts(snapshot.links, FAULTS), *warning_count(snapshot.links))
        height, only = self.app.size.height, self.topics.faults_only
        keys = MoreKeys(key("links"), f"{key('detail')} on one" if only else key("faults"))
        faults = [*explanations.faults(snapshot, [*self.log_pane.events, *self._held]), *faults_of(snapshot)]
        self.faults.show(faults, max(3, height // (2 if only else 4)), keys, snapshot.time)
        if self.frozen_since is None:
            self.log_pane.add(self._held)
            self._held = []
            self.topics.show(snapshot)
            no_match = f"Nothing here matches. {key('back')} shows all topics."
            self.topics.explain(no_match if self.topics.rows else explanations.why_empty(snapshot))
            self.show_detail()
        self.show_keys()

    def hold(self, new_events: Sequence[Event]) -> None:
        """Keep events for the next `show`."""
        self._held += new_events

    def reset(self) -> None:
        """Forget the log of a session, as another one begins."""
        self._held, self.frozen_since = [], None
        self.log_pane.clear()

    def show_detail(self) -> None:
        # The hidden pane of a narrow screen costs nothing.
        if self.detail.display:
            route = self.topics.selected
            self.detail.show(route, "" if route is None else self.console.peer_of(route), self.topics.now)

    @on(events.ScreenSuspend)
    @on(events.ScreenResume)
    @on(events.DescendantFocus)
    def show_keys(self) -> None:
        """Show the keys that are possible now, if they have changed; none below a dialog, which has its own."""
        here = self.app.screen is self
        entries = [
            entry
            for action in self._actions.values()
            if here and action.in_footer
            if (entry := self._key_entry(action))
        ]
        if entries != self._keys_shown:
            self._keys_shown = entries
            self.key_bar.show(entries)

    def _key_entry(self, action: Action) -> KeyEntry | None:
        if not self.check_action(action.id, ()):
            return None
        footer = FooterEntry(action.label) if action.footer is None else action.footer(self)
        if footer is None:
            return None
        rank = 0 if action.stays else 1 if footer.counts or footer.keeps_place else 2
        key, place = self.console.key_labels(action)[0], NAMESPACE[action.group]
        return KeyEntry(key, footer.label, f"{place}.{action.id}", rank, footer.counts)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Grey out actions that need a topic while none is selected; hide all changes while read-only."""
        known = self._actions.get(action)
        if known is None:
            return super().check_action(action, parameters)
        if known.group is Group.OPERATE and self.console.engine is None:
            return None
        if known.possible is not None and not (possible := known.possible(self)):
            return possible
        if known.needs_topic and self.topics.selected is None:
            return None
        return self.app.check_action(action, parameters)

    def on_key(self, event: events.Key) -> None:
        """Explain why a key for a change does nothing."""
        # A key comes here only if its action is disabled.
        keys = self.console.preferences.keys
        if self.console.readonly and any(a.changes and event.key in keys(a) for a in self._actions.values()):
            self.notify(MainText.READ_ONLY(), timeout=2)

    def on_selectable_list_cursor_moved(self, event: SelectableList.CursorMoved) -> None:
        if event.pane is self.topics:
            self.show_detail()

    def on_selectable_list_chosen(self, event: SelectableList.Chosen) -> None:
        if event.pane in {self.topics, self.log_pane}:
            self.act(BY_ID["detail"])

    def on_resize(self, event: events.Resize) -> None:
        """Fill the detail, which may have come into view."""
        self.call_after_refresh(self.show_detail)

    @property
    def pane(self) -> TopicsTable | LogPane:
        """The pane that filter, export and the like act on: the log if it has the focus, otherwise the topics."""
        return self.log_pane if self.log_pane.has_focus else self.topics

    def on_prompt_changed(self, event: Prompt.Changed) -> None:
        self.filtered.pattern = event.pattern
        self.filtered.relist()

    def on_prompt_closed(self) -> None:
        self.set_focus(self.filtered)

    @property
    def mode(self) -> str | None:
        """The one of `MODES` that gives a pane the whole screen, or None."""
        return next((mode for mode in MODES if self.has_class(mode)), None)

    def set_mode(self, mode: str | None) -> None:
        """Give one pane the whole screen, or share it among all with None."""
        for other in MODES:
            self.set_class(other == mode, other)
        {"-detail": self.detail, "-log": self.log_pane}.get(mode or "", self.topics).focus()
        self.call_after_refresh(self.show_detail)
