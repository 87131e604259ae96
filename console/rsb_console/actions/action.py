"""An action of an operator: a key with its name, its texts, its condition and what it does."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot


class Group(StrEnum):
    """An action's chapter in the help, which also says where its handler ``action_<id>`` is."""

    MOVE = "Move"  # the focused list
    VIEW = "View"  # the main screen
    OPERATE = "Operate"  # the main screen
    SESSION = "Session"  # the main screen
    OWN = "Own commands"  # the main screen
    CONSOLE = "Console"  # the app
    FLEET = "Fleet"  # the fleet's screen


NAMESPACE = {
    Group.MOVE: "focused", Group.VIEW: "screen", Group.OPERATE: "screen", Group.SESSION: "screen", Group.CONSOLE: "app",
    Group.OWN: "screen", Group.FLEET: "screen",
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


class CameraSight(NamedTuple):
    """The age of what an operator sees of a robot.

    Attributes:
        age: s since the picture on the screen came to the robot's bridge, or None if that is unknown.
        still: s for which its content had not changed by then.
    """

    age: float | None
    still: float = 0.0


class OnRobot(NamedTuple):
    """An action on a screen that shows a robot instead of the list of topics, such as its camera's picture.

    Attributes:
        key: Textual key name there.
        suits: whether it may act on a topic of that robot, so that the screen shows the key.
        run: acts on one of the topics of that robot, or says why on none; a coroutine function of a
            `rsb_console.console_api.Console`, the topics, and a function that returns the age of the camera's picture
            on the screen, or None if there is none.
    """

    key: str
    suits: Callable[[RouteSnapshot], bool]
    run: Callable[[Any, Sequence[RouteSnapshot], Callable[[], CameraSight | None]], Awaitable[None]]


class OnNode(NamedTuple):
    """An action on the node under the cursor in a list of nodes.

    Attributes:
        key: Textual key name there.
        label: the key with its meaning, for that list's line of keys.
        run: a coroutine function of a `rsb_console.console_api.Console`, the name of the link to the node's side, which
            is empty for this side, and the node's full name.
    """

    key: str
    label: str
    run: Callable[[Any, str, str], Awaitable[None]]


class Beginning(NamedTuple):
    """An action in the menu of all ways to begin.

    Attributes:
        key: Textual key name there, besides the action's own.
        about: what follows the label.
        place: its place in the menu; the core's are 2 and 3.
        button: its label among the buttons of the list of sessions, or empty if it has none there.
        writes: whether it writes files: then it is not in the menu of a read-only console.
    """

    key: str
    label: str
    about: str
    place: int
    button: str = ""
    writes: bool = True


class FooterEntry(NamedTuple):
    """An action in the footer, as the present state makes it.

    Attributes:
        counts: figures after the label, with their looks.
        keeps_place: whether it stays where others find no room.
    """

    label: str
    counts: tuple[tuple[str, str], ...] = ()
    keeps_place: bool = False


@dataclass(frozen=True, slots=True)
class Action:
    """One action of an operator.

    Functions of the main screen take a `rsb_console.screens.main.MainScreen`.

    Attributes:
        id: names the handler, ``action_<id>``, and the action in ``keys.yaml``.
        keys: Textual key names, comma-separated; the first is the one that is shown.
        label: shown in the footer after the key.
        help: its description in the help and the palette.
        changes: whether it changes the bridge or a file, so that ``--readonly`` disables it.
        needs_topic: whether it acts on the topic under the cursor, and is greyed out without one.
        in_footer: whether the footer shows it.
        stays: whether the narrowest footer shows it, too, as help, which lists all others.
        also: other words by which the palette finds it.
        run: what it does, a function of the main screen: a coroutine function if it waits, for a dialog for example.
            None if each list, screen or app that has the action has a method of its own for it.
        possible: a function of the main screen: whether the action is possible now; None greys it out. None if it
            always is.
        footer: a function of the main screen: how the footer shows it now, None if not at all. None if by its label.
        stops: a function of the main screen: whether the action stops a robot now, and so acts at once, even if its
            topic has just come under the cursor. None if it never does.
        on_robot: the same on screens that show a robot; or None.
        with_message: the same with a message that another screen has made, such as a goal on a map: a coroutine
            function of a `rsb_console.console_api.Console`, a topic, a type and fields as YAML; or None.
        on_link: the same on a link under the cursor in the list of links: a coroutine function of a
            `rsb_console.console_api.Console` and the link's snapshot; or None.
        on_node: the same on the node under the cursor in a list of nodes; or None.
        after: the id of the action that it follows in help, footer and palette; or empty, to be the last.
        begins: how menus offer it as a way to begin, or None; then `run` is a coroutine function.
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
    stays: bool = False
    also: str = ""
    run: Callable[[Any], Awaitable[None] | None] | None = None
    possible: Callable[[Any], bool | None] | None = None
    footer: Callable[[Any], FooterEntry | None] | None = None
    stops: Callable[[Any], bool] | None = None
    on_robot: OnRobot | None = None
    with_message: Callable[[Any, str, str, str], Awaitable[None]] | None = None
    on_link: Callable[[Any, LinkSnapshot], Awaitable[None]] | None = None
    on_node: OnNode | None = None
    after: str = ""
    begins: Beginning | None = None
    chapters: tuple[KeyChapter, ...] = ()


_late_modules: dict[str, None] = {}


class _Late:
    def __init__(self, place: str) -> None:
        self._module, self._name = place.split(":")
        _late_modules[self._module] = None

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

    @property
    def function(self) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(import_module(self._module), self._name)
        return function


def late(place: str) -> Callable[..., Any]:
    """Return a function, ``package.module:function``, that is imported once it is called, to keep the start short."""
    return _Late(place)


def call_of(function: Callable[..., Any], *arguments: Any) -> partial[Any]:
    """Return a call to come, for a worker: of a `late` function, which is imported now, as of any other."""
    if isinstance(function, partial):
        return partial(call_of(function.func), *function.args, *arguments, **function.keywords)
    return partial(function.function if isinstance(function, _Late) else function, *arguments)


def late_modules() -> tuple[str, ...]:
    """Return the modules that `late` has been told of."""
    return tuple(_late_modules)
