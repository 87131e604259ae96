"""All actions of an operator. Key bindings, footer, help and command palette are made from this registry."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from textual.binding import Binding

from rsb_bridge.feature import installed

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from rsb_bridge.model.snapshot import RouteSnapshot


class Group(StrEnum):
    """An action's chapter in the help, which also says where its handler is."""

    MOVE = "Move"  # the focused list
    VIEW = "View"  # the main screen
    OPERATE = "Operate"  # the main screen
    SESSION = "Session"  # the main screen
    CONSOLE = "Console"  # the app
    FLEET = "Fleet"  # the fleet's screen


NAMESPACE = {
    Group.MOVE: "focused", Group.VIEW: "screen", Group.OPERATE: "screen", Group.SESSION: "screen", Group.CONSOLE: "app",
    Group.FLEET: "screen",
}  # fmt: skip


class KeyChapter(NamedTuple):
    """The keys of a screen that has its own.

    Attributes:
        screen: name of the screen's class, or of a base of it.
        keys: keys, and their meaning.
    """

    title: str
    screen: str
    keys: tuple[tuple[str, str], ...]


class OnRobot(NamedTuple):
    """An action on a screen that shows a robot instead of the list of topics, such as its camera's picture.

    Attributes:
        key: Textual key name there.
        suits: whether it may act on a topic of that robot, so that the screen shows the key.
        run: acts on one of the topics of that robot, or says why on none; a coroutine function of a
            `rsb_console.console_api.Console` and the topics.
    """

    key: str
    suits: Callable[[RouteSnapshot], bool]
    run: Callable[[Any, Sequence[RouteSnapshot]], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class Action:
    """One action of an operator.

    Attributes:
        id: names the handler, ``action_<id>``, and the action in ``keys.yaml``.
        keys: Textual key names, comma-separated; the first is the one that is shown.
        label: shown in the footer after the key.
        help: its description in the help and the palette.
        changes: whether it changes the bridge or a file, so that ``--readonly`` disables it.
        needs_topic: whether it acts on the topic under the cursor.
        in_footer: whether the footer shows it.
        also: other words by which the palette finds it.
        run: of a feature, what it does: a coroutine function of the main screen
            (`rsb_console.screens.main.MainScreen`); else None.
        on_robot: the same on screens that show a robot; or None.
        with_message: the same with a message that another screen has made, such as a goal on a map: a coroutine
            function of a `rsb_console.console_api.Console`, a topic, a type and fields as YAML; or None.
        after: of a feature, the id of the action that it follows in help and palette; or empty, to be the last.
        chapters: the keys of the screens that it opens, for the help.
    """

    id: str
    keys: str
    label: str
    help: str
    group: Group
    _: KW_ONLY
    changes: bool = False
    needs_topic: bool = False
    in_footer: bool = False
    also: str = ""
    run: Callable[[Any], Awaitable[None]] | None = None
    on_robot: OnRobot | None = None
    with_message: Callable[[Any, str, str, str], Awaitable[None]] | None = None
    after: str = ""
    chapters: tuple[KeyChapter, ...] = ()


def late(place: str) -> Callable[..., Any]:
    """Return a function, ``package.module:function``, that is imported once it is called, to keep the start short."""
    module, name = place.split(":")

    def call(*arguments: Any) -> Any:
        return getattr(import_module(module), name)(*arguments)

    return call


# No Ctrl+S, Q, A, B, J or Enter, and no Alt: terminals and multiplexers take these for themselves.
# The footer shows them in this order, as many as fit: what an operator needs most comes first.
_OF_CORE: tuple[Action, ...] = (
    Action("move_down", "j,down", "down", "Next line", Group.MOVE),
    Action("move_up", "k,up", "up", "Previous line", Group.MOVE),
    Action("move_first", "g,home", "first", "First line", Group.MOVE),
    Action("move_last", "G,end", "last", "Last line", Group.MOVE),
    Action("page_down", "pagedown", "page down", "One page down", Group.MOVE),
    Action("page_up", "pageup", "page up", "One page up", Group.MOVE),
    Action("add_topic", "a", "add", "Add a topic, service, action or parameters from either side",
           Group.OPERATE, changes=True, in_footer=True),
    Action("edit_topic", "e", "edit", "Edit the topic or the service",
           Group.OPERATE, changes=True, needs_topic=True, in_footer=True,
           also="limit the rate, bandwidth, throttle, type, QoS, protocol, port, compression"),
    Action("remove_topic", "d", "remove", "Remove the topic or the service",
           Group.OPERATE, changes=True, needs_topic=True, in_footer=True),
    Action("pause", "p", "pause", "Pause or resume the topic or the service",
           Group.OPERATE, changes=True, needs_topic=True, in_footer=True),
    Action("acknowledge", "i", "acknowledge", "Acknowledge the fault until it changes, or take that back",
           Group.OPERATE, changes=True, needs_topic=True, also="known, silence, mute, ack, ignore"),
    Action("undo", "u", "undo", "Undo the last change of this console, after a question",
           Group.OPERATE, changes=True, in_footer=True, also="revert, put back, restore a removed topic"),
    Action("arm", "A", "arm", "Arm the topic or the service, or disarm it",
           Group.OPERATE, changes=True, needs_topic=True, in_footer=True, also="deadman, safety, enable"),
    Action("call", "C", "call", "Call the service or action by hand; of a node: set a parameter",
           Group.OPERATE, changes=True, needs_topic=True, in_footer=True, also="request, send a goal, param get list"),
    Action("detail", "enter", "detail", "Open the details, then a topic's message; or the full log line",
           Group.VIEW, needs_topic=True, in_footer=True),
    Action("message", "v", "message", "View a topic's messages, as a picture or as text", Group.VIEW, needs_topic=True),
    Action("back", "escape", "back", "Close what is open, or drop the filter", Group.VIEW),
    Action("filter", "slash", "filter", "Filter: terms, !terms; state: kind: robot: type: via: why:",
           Group.VIEW, in_footer=True),
    Action("next_match", "n", "next", "Next match; without a filter, next fault", Group.VIEW),
    Action("previous_match", "N", "previous", "Previous match; without a filter, previous fault", Group.VIEW),
    Action("faults", "f", "faults", "Show faults only", Group.VIEW, in_footer=True),
    Action("sort_left", "less_than_sign", "sort", "Sort by the column to the left", Group.VIEW),
    Action("sort_right", "greater_than_sign", "sort", "Sort by the column to the right", Group.VIEW),
    Action("reverse", "s", "reverse", "Reverse the order", Group.VIEW),
    Action("group", "B", "group", "Group the topics by robot", Group.VIEW),
    Action("columns", "vertical_line", "columns", "Choose the columns of the topics", Group.VIEW, also="hide, show"),
    Action("freeze", "space", "freeze", "Freeze the view; the bridge goes on", Group.VIEW),
    Action("zoom", "z", "zoom", "Give the focused pane the whole screen", Group.VIEW),
    Action("log", "l", "log", "Go to the log, and back", Group.VIEW, in_footer=True),
    Action("level", "L", "level", "Log level: all, info, WARN, ERROR", Group.VIEW),
    Action("copy", "y", "copy", "Copy the line under the cursor, over SSH too", Group.VIEW),
    Action("export", "x", "export", "Write the focused pane's lines to a file", Group.VIEW),
    Action("retry", "r", "retry", "Try to connect again now", Group.OPERATE, changes=True),
    Action("restart", "R", "restart", "Close all links on both sides and open them again",
           Group.OPERATE, changes=True, in_footer=True),
    Action("reload", "f6", "reload", "Read the session file again, and change what differs",
           Group.OPERATE, changes=True),
    Action("links", "c", "links", "Show the links; a server has one per robot", Group.SESSION, in_footer=True),
    Action("bluetooth", "b", "bluetooth", "Find Bluetooth adapters, devices and free channels",
           Group.SESSION, in_footer=True),
    Action("keys", "K", "keys", "Show the key files, or make a key", Group.SESSION, in_footer=True),
    Action("sessions", "o", "sessions", "Open another session", Group.SESSION, changes=True, in_footer=True),
    Action("save", "w", "save", "Save the session with its present topics",
           Group.SESSION, changes=True, in_footer=True),
    Action("save_as", "W", "save as", "Save the session to another file", Group.SESSION, changes=True),
    Action("new_session", "f2", "new", "Write a new session", Group.SESSION, changes=True),
    Action("import_session", "f3", "import", "Import a file of another bridge",
           Group.SESSION, changes=True),
    Action("demo", "f4", "demo", "Run the demo: a simulated robot on this machine", Group.SESSION, changes=True),
    Action("welcome", "f5", "welcome", "Show the welcome screen", Group.SESSION, changes=True),
    Action("faster", "plus", "faster", "Refresh more often", Group.CONSOLE),
    Action("slower", "minus", "slower", "Refresh less often", Group.CONSOLE),
    Action("theme", "t", "theme", "Next theme", Group.CONSOLE),
    Action("mouse", "m", "mouse", "Give the mouse to the terminal, or take it back", Group.CONSOLE),
    Action("bell_on_fault", "exclamation_mark", "bell", "Turn the terminal's bell for new faults on or off",
           Group.CONSOLE, also="sound, alarm, beep, notify"),
    Action("palette", "colon,ctrl+p", "palette", "Find an action by its name", Group.CONSOLE),
    Action("help", "question_mark,f1", "help", "Show every key", Group.CONSOLE, in_footer=True),
    Action("quit", "q", "quit", "Quit; the bridge stops, unless it runs in another process",
           Group.CONSOLE, in_footer=True),
)  # fmt: skip


def _with_features() -> tuple[Action, ...]:
    """Return the core's actions with the features', each behind the action that it follows."""
    actions = list(_OF_CORE)
    for action in (each for feature in installed() for each in feature.actions()):
        places = [place for place, each in enumerate(actions, 1) if each.id == action.after]
        actions.insert(places[0] if places else len(actions), action)
    return tuple(actions)


ACTIONS = _with_features()


KEYS_ON_SCREENS: tuple[KeyChapter, ...] = (
    *(chapter for action in ACTIONS for chapter in action.chapters),
    KeyChapter(
        "In a form",
        "FormScreen",
        (
            ("↑ ↓ tab", "Next or previous field"),
            ("⏎", "Go to what is missing, else accept"),
            ("F7", "Of a topic: go to a field by the beginning of its name"),
            ("F8", "Of something to add: show all fields"),
            ("esc", "Leave without a change"),
        ),
    ),
)
BY_ID = {action.id: action for action in ACTIONS}


def screens() -> list[tuple[Action, ...]]:
    """Return the actions of the console, and of each screen that takes its place."""
    return [ACTIONS, *(actions for feature in installed() for actions in feature.screens())]


def bindings(*groups: Group, actions: tuple[Action, ...] = ACTIONS) -> list[Any]:
    """Textual's key bindings of the actions in some groups."""
    return [Binding(a.keys, a.id, a.label, id=a.id, show=False) for a in actions if a.group in groups]
