"""The main screen: topics, detail and log. Changes of the bridge are in `rsb_console.operations`."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from textual import events, on
from textual.binding import Binding
from textual.containers import Horizontal
from textual.screen import ModalScreen, Screen
from textual.widgets import Static

from rsb_bridge.config.files import why_not_written
from rsb_bridge.feature import installed
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.wording import Wording
from rsb_console.actions import ACTIONS, BY_ID, Group, bindings
from rsb_console.look import formats
from rsb_console.look.formats import PatternRow
from rsb_console.preferences import TOPIC_COLUMNS
from rsb_console.screens.dialog import Dialog
from rsb_console.widgets.bars import BarState, KeyBar, KeyEntry, StatusBar, state_counts, warning_count
from rsb_console.widgets.detail import DetailPane
from rsb_console.widgets.fault_pane import Fault, FaultLines, MoreKeys, faults_of
from rsb_console.widgets.filter import Prompt
from rsb_console.widgets.lines import fit
from rsb_console.widgets.log import WORD, LogPane, plain
from rsb_console.widgets.selectable_list import SelectableList
from rsb_console.widgets.topics import FAULTS, TopicsTable, is_armed

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import Event, RouteSnapshot, Snapshot
    from rsb_console.actions import Action
    from rsb_console.console_api import Console
    from rsb_console.widgets.lines import Line

MODES = ("-detail", "-log", "-table")  # classes that give one pane the screen


class EmptyTable(Wording):
    """Texts of a table without topics."""

    NO_SESSION = "No session. {opens} opens one, {new} writes a new one, {welcome} shows all ways to begin."
    NO_SESSION_READ_ONLY = "No session. Start the console with one: rsb-console --readonly SESSION"


class MainText(Wording):
    """Notes of the main screen."""

    READ_ONLY = "read-only: nothing can be changed here"
    IS_PATTERN = "{topic} is a pattern: choose a topic that it matches"
    NO_MESSAGES = "{topic} has calls, no messages"
    NO_MESSAGES_BUT_CALLS = "{topic} has calls, no messages: {key} calls it by hand"


class Explanations:
    """Says why the bridge does not run or the table is empty, and which key to press."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def key(self, action: str) -> str:
        return self._console.key_labels(BY_ID[action])[0]

    def bar(self, snapshot: Snapshot, frozen_since: float | None) -> BarState:
        """Return what the status bar shows in addition to the snapshot."""
        console, engine = self._console, self._console.engine
        session = "" if console.path is None else console.path.stem
        way_on = "" if snapshot.running or engine is None else self._way_on()
        lost = "" if engine is None or not engine.unreachable else f"✗ NOT ATTACHED: {engine.unreachable}"
        attached, note = bool(console.attached_to), console.note or lost
        return BarState(session, console.refresh_rate, frozen_since, console.readonly, note, way_on, attached=attached)

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

    Textual looks up an action's handler on the screen, as ``action_<id>``. Handlers of the view are methods here;
    handlers of the operations are methods of other objects, named after the actions.

    Args:
        operations: for each group of actions an object with their methods, which may wait for dialogs.
    """

    BINDINGS = bindings(Group.VIEW, Group.OPERATE, Group.SESSION)
    BLANK = True  # as its `Panes`
    AUTO_FOCUS = "#topics"
    # From 110 columns on, the table has `topics.WIDE` cells with the details in sight.
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (110, "-wide")]  # noqa: RUF012 -- Textual declares it without ClassVar
    VERTICAL_BREAKPOINTS = [(0, "-tiny"), (14, "-short"), (30, "-tall")]  # noqa: RUF012 -- as above

    def __init__(self, console: Console, operations: Mapping[Group, object]) -> None:
        super().__init__()
        self.console = console
        self._explanations = Explanations(console)
        for action in ACTIONS:
            if action.run is not None or action.group in operations:
                run = action.run
                method = getattr(operations[action.group], action.id) if run is None else partial(run, self)
                setattr(self, f"action_{action.id}", partial(self._run_operation, method, action))
        self.status, self.faults, self.prompt, self.key_bar = StatusBar(), FaultLines(), Prompt(), KeyBar()
        self.topics, self.detail, self.log_pane = TopicsTable(), DetailPane(), LogPane()
        self._filtered: TopicsTable | LogPane = self.topics
        self._frozen_since: float | None = None
        self._held: list[Event] = []
        self._keys_shown_for: tuple[object, ...] = ()
        self._topic_counts: Line = ()
        self._link_counts: Line = ()
        self._unsaved = False

    def _run_operation(self, operation: Callable[[], Awaitable[None]], action: Action) -> None:
        if action.needs_topic:
            if not (action.id == "arm" and self._disarms) and not self.topics.is_seen():
                return
            self.topics.hold()  # the next key is for the same topic, wherever its new state puts it
        exclusive = action.group is Group.SESSION  # another choice of a session replaces one that waits in a dialog
        self.run_worker(operation(), group=action.group, exclusive=exclusive)

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
        explanations, key = self._explanations, self._explanations.key
        self.status.show(snapshot, explanations.bar(snapshot, self._frozen_since))
        self._unsaved = snapshot.unsaved
        self._topic_counts = state_counts(snapshot.routes, FAULTS)
        self._link_counts = (*state_counts(snapshot.links, FAULTS), *warning_count(snapshot.links))
        height, only = self.app.size.height, self.topics.faults_only
        keys = MoreKeys(key("links"), f"{key('detail')} on one" if only else key("faults"))
        faults = [*explanations.faults(snapshot, [*self.log_pane.events, *self._held]), *faults_of(snapshot)]
        self.faults.show(faults, max(3, height // (2 if only else 4)), keys, snapshot.time)
        if self._frozen_since is None:
            self.log_pane.add(self._held)
            self._held = []
            self.topics.show(snapshot)
            no_match = f"Nothing here matches. {key('back')} shows all topics."
            self.topics.explain(no_match if self.topics.rows else explanations.why_empty(snapshot))
            self.show_detail()
        self.show_keys()

    def hold(self, new_events: Sequence[Event]) -> None:
        """Show events later, with the next `show`."""
        self._held += new_events

    def reset(self) -> None:
        """Begin another session: forget the old one's log."""
        self._held = []
        self._frozen_since = None
        self.log_pane.clear()

    def show_detail(self) -> None:
        """Show the topic under the cursor."""
        # The hidden pane of a narrow screen costs nothing.
        if self.detail.display:
            route = self.topics.selected
            self.detail.show(route, "" if route is None else self.console.peer_of(route), self.topics.now)

    @on(events.ScreenSuspend)
    @on(events.ScreenResume)
    @on(events.DescendantFocus)
    def show_keys(self) -> None:
        """Show the keys that are possible now, if they have changed."""
        counts = {"faults": self._topic_counts, "links": self._link_counts}
        route = self.topics.route
        can = (self._disarms, *(() if route is None else (route.arming is not None, route.lanes)))
        reads_log, here = self.log_pane.has_focus, self.app.screen is self
        undoes = len(self.console.changes)
        nothing = self.topics.selected is None
        of_changes = (undoes, self._unsaved)
        depends_on = (here, reads_log, self.console.engine is None, nothing, can, of_changes, *counts.values())
        if depends_on == self._keys_shown_for:
            return
        self._keys_shown_for = depends_on
        useful = {"undo": bool(undoes), "save": self._unsaved}
        labels = {"arm": "disarm" if self._disarms else "arm", "detail": "whole line" if reads_log else "detail"}
        if not here:  # a dialog's keys are the only ones
            self.key_bar.show([])
            return
        self.key_bar.show(
            [
                KeyEntry(
                    self.console.key_labels(action)[0],
                    labels.get(action.id, action.label),
                    f"{'app' if action.group is Group.CONSOLE else 'screen'}.{action.id}",
                    # Help stays on any screen, as it lists all others.
                    0 if action.id in ("help", "quit") else 1 if counts.get(action.id) or action.id == "save" else 2,
                    counts.get(action.id, ()),
                )
                for action in ACTIONS
                if action.in_footer and self.check_action(action.id, ()) and useful.get(action.id, True)
            ]
        )

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Grey out actions that need a topic while none is selected; hide all changes while read-only."""
        known = BY_ID.get(action)
        if known is None:
            return super().check_action(action, parameters)
        if known.group is Group.OPERATE and self.console.engine is None:
            return None
        route = self.topics.route
        if action == "arm" and (route is None or route.arming is None) and not self._disarms:
            return False
        if action == "call" and (route is None or not route.lanes):
            return False
        if known.needs_topic and self.topics.selected is None and not (action == "detail" and self.log_pane.has_focus):
            return None
        return self.app.check_action(action, parameters)

    @property
    def _disarms(self) -> bool:
        """Whether the key that arms would disarm: the topic under the cursor, or else what this console holds."""
        route = self.topics.route
        return bool(self.console.deadman.held) if route is None or route.arming is None else is_armed(route)

    def on_key(self, event: events.Key) -> None:
        """Explain why a key for a change does nothing."""
        # A key comes here only if its action is disabled.
        if self.console.readonly and any(a.changes and event.key in self.console.preferences.keys(a) for a in ACTIONS):
            self.notify(MainText.READ_ONLY(), timeout=2)

    def on_selectable_list_cursor_moved(self, event: SelectableList.CursorMoved) -> None:
        if event.pane is self.topics:
            self.show_detail()

    def on_selectable_list_chosen(self, event: SelectableList.Chosen) -> None:
        if event.pane in {self.topics, self.log_pane}:
            self.action_detail()

    def on_resize(self, event: events.Resize) -> None:
        """Fill the detail, which may have come into view."""
        self.call_after_refresh(self.show_detail)

    # -- view actions -------------------------------------------------------------------------------------------------

    @property
    def _list(self) -> TopicsTable | LogPane:
        """The pane that filter, export and the like act on: the log if it has the focus, otherwise the topics."""
        return self.log_pane if self.log_pane.has_focus else self.topics

    def action_filter(self) -> None:
        pattern = self._list.pattern
        self._filtered = self._list
        self.prompt.open("" if pattern is None else pattern.text)

    def on_prompt_changed(self, event: Prompt.Changed) -> None:
        self._filtered.pattern = event.pattern
        self._filtered.relist()

    def on_prompt_closed(self) -> None:
        self.set_focus(self._filtered)

    def action_next_match(self) -> None:
        self._list.next_match(1)

    def action_previous_match(self) -> None:
        self._list.next_match(-1)

    def action_faults(self) -> None:
        self.topics.faults_only = not self.topics.faults_only
        self.topics.relist()
        self.console.pull()

    def action_sort_left(self) -> None:
        """Sort by the column to the left."""
        self.topics.sort_by(-1)

    def action_sort_right(self) -> None:
        """Sort by the column to the right."""
        self.topics.sort_by(1)

    def action_reverse(self) -> None:
        self.topics.reverse()

    def action_group(self) -> None:
        self.topics.grouped = not self.topics.grouped
        self.topics.relist()

    def action_columns(self) -> None:
        """Have the operator choose the columns of the topics."""
        self.app.push_screen(ColumnsScreen(self.console, self.topics))

    def action_freeze(self) -> None:
        """Freeze the screen, or continue."""
        self._frozen_since = time.time() if self._frozen_since is None else None
        self.console.pull()

    def action_level(self) -> None:
        self.log_pane.next_level()

    # -- panes --------------------------------------------------------------------------------------------------------

    def _mode(self, mode: str | None) -> None:
        """Give one pane the whole screen, or share it among all with None."""
        for other in MODES:
            self.set_class(other == mode, other)
        {"-detail": self.detail, "-log": self.log_pane}.get(mode or "", self.topics).focus()
        self.call_after_refresh(self.show_detail)

    def action_detail(self) -> None:
        """Open a log line or a topic's details: focus the pane, or give it the whole of a narrow screen."""
        if self.log_pane.has_focus and self.log_pane.selected is not None:
            self.app.push_screen(EventScreen(self.log_pane.selected))
        elif self.detail.has_focus:
            self.action_message()
        elif self.detail.display:
            self.detail.focus()
        else:
            self._mode("-detail")

    def action_message(self) -> None:
        route = self.topics.selected
        if route is None or self.console.engine is None:
            return
        if isinstance(route, PatternRow):
            self.notify(MainText.IS_PATTERN(topic=route.topic), markup=False, timeout=4)
        elif route.calls is None:
            self._show_messages(route)
        else:
            text = MainText.NO_MESSAGES if self.console.readonly else MainText.NO_MESSAGES_BUT_CALLS
            self.notify(text(topic=route.topic, key=self._explanations.key("call")), markup=False, timeout=4)

    def _show_messages(self, route: RouteSnapshot) -> None:
        """Show a topic's messages in the usual way of their type, then in the others, until the screen is closed."""
        from rsb_console.screens.message_screen import MessageScreen  # noqa: PLC0415 -- keeps the start short

        views = [view for feature in installed() for view in feature.message_views()]
        as_text = partial(MessageScreen, other=views[0].name if views else "")
        ways = [*(view.screen for view in views), as_text]
        usual = next((at for at, view in enumerate(views) if view.suits(route.type_name)), len(views))

        def show(at: int) -> None:
            self.app.push_screen(
                ways[at % len(ways)](self.console, route), lambda other: show(at + 1) if other else None
            )

        show(usual)

    def action_zoom(self) -> None:
        """Maximize the focused pane, or restore the layout."""
        if any(self.has_class(mode) for mode in MODES):
            self._mode(None)
        else:
            self._mode("-log" if self.log_pane.has_focus else "-detail" if self.detail.has_focus else "-table")

    def action_log(self) -> None:
        """Focus the log, maximized if it has no room, or go back."""
        if self.log_pane.has_focus:
            self._mode(None)
        elif self.log_pane.display:
            self.log_pane.focus()
        else:
            self._mode("-log")

    def action_back(self) -> None:
        """Close the open pane, or drop the filters."""
        if any(self.has_class(mode) for mode in MODES):
            self._mode(None)
        elif not self.topics.has_focus:
            self.topics.focus()
        elif self.topics.pattern is not None or self.topics.faults_only:
            self.topics.pattern, self.topics.faults_only = None, False
            self.topics.relist()

    # -- text out -----------------------------------------------------------------------------------------------------

    def action_copy(self) -> None:
        """Copy the line under the cursor."""
        from rsb_console.terminal.driver import copy  # noqa: PLC0415 -- seldom needed

        event, route = self.log_pane.selected, self.topics.selected
        text = plain(event) if self.log_pane.has_focus and event else route.topic if route else ""
        if text:
            self.notify(copy(self.app, text), timeout=3, markup=False)

    def action_export(self) -> None:
        """Export the focused list to a file in the working folder."""
        from rsb_console.session.exports import export_log, export_topics  # noqa: PLC0415 -- seldom needed

        log = self._list is self.log_pane
        try:
            path = export_log(self.log_pane.listed) if log else export_topics(self.topics.listed)
        except OSError as error:
            self.notify(why_not_written(error, Path()), title="Not exported", severity="error", markup=False)
        else:
            self.notify(f"written to {path}", markup=False)


class ColumnsList(SelectableList):
    """The columns that an operator may choose, with a mark on each chosen one.

    Args:
        topics: the table whose columns they are.
    """

    def __init__(self, topics: TopicsTable) -> None:
        super().__init__(id="columns")
        self._topics = topics
        self.keys = list(TOPIC_COLUMNS)

    def on_mount(self) -> None:
        """Set the height to the number of lines."""
        self.styles.height = self.line_count
        self.sync()

    @property
    def chosen(self) -> frozenset[str]:
        wanted = self._topics.wanted_columns
        return frozenset(self.keys) if wanted is None else wanted

    def line(self, index: int) -> Line:
        title = self.keys[index]
        wanted = title in self.chosen
        why = self._topics.why_not_shown(title) if wanted else ""
        pieces = (
            ("▌" if self.is_cursor(index) else " ", "key"),
            (f"{'✓' if wanted else ' '} ", "ok"),
            (f"{title:<13}", "strong" if wanted else ""),
            (TOPIC_COLUMNS[title], "" if wanted else "dim"),
            (f": {why}" if why else "", "dim"),
        )
        return fit(pieces, self.size.width)


class ColumnsScreen(ModalScreen[None]):
    """The columns of the topics; each choice is shown at once, and kept for the next start."""

    BINDINGS: ClassVar = [
        Binding(f"escape,q,{BY_ID['columns'].keys}", "dismiss", show=False),
        Binding("space,enter", "choose", show=False),
    ]

    def __init__(self, console: Console, topics: TopicsTable) -> None:
        super().__init__()
        self.console, self._topics = console, topics
        self._list = ColumnsList(topics)

    def compose(self) -> ComposeResult:
        yield Dialog("Columns", self._list, keys="space show or hide   esc close", shape="")

    def action_choose(self) -> None:
        """Show the column under the cursor, or hide it."""
        self._topics.wanted_columns = chosen = self._list.chosen ^ {self._list.keys[self._list.position]}
        self._topics.relist()
        self._list.sync()
        self.console.remember("columns", [title for title in TOPIC_COLUMNS if title in chosen])

    def on_selectable_list_chosen(self) -> None:
        self.action_choose()


class EventScreen(ModalScreen[None]):
    """The whole text of an event."""

    BINDINGS: ClassVar = [Binding("escape,q,enter", "dismiss", show=False)]

    def __init__(self, event: Event) -> None:
        super().__init__()
        self._event = event

    def compose(self) -> ComposeResult:
        """Compose the text, and below it the link and the topic."""
        event = self._event
        concerns = [word for word in (event.code, event.link, event.topic) if word]
        yield Dialog(
            f"{WORD[event.level]} at {formats.time_of_day(event.time)}",
            Static(event.text, markup=False),
            Static(" · ".join(concerns), classes="hint keys", markup=False),
            keys="esc close",
        )
