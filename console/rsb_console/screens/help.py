"""Every key, and the entries of the command palette, from the registry of actions."""

from __future__ import annotations

import textwrap
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

from textual.binding import Binding
from textual.command import DiscoveryHit, Hit, Provider
from textual.screen import ModalScreen

from rsb_console.actions.action import NAMESPACE, Group
from rsb_console.actions.all_actions import KEYS_ON_SCREENS
from rsb_console.widgets.key_hints import spelled
from rsb_console.widgets.lines import ScrolledLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from textual.app import ComposeResult
    from textual.command import Hits
    from textual.geometry import Size
    from textual.screen import Screen

    from rsb_console.actions.action import Action, KeyChapter
    from rsb_console.console_api import ConsoleShell
    from rsb_console.widgets.lines import Line

KEYS_WIDTH, ID_WIDTH = 13, 15  # cells
_FIRST = 1000.0
"""More than Textual's score of any match: it counts only among the equally close."""
OWN_KEYS = "console.yaml"
"""The file with the keys of an operator's own commands, where others have the id for ``keys.yaml``."""


class KeyList(ScrolledLines):
    """One line for each key, and the headings."""

    def __init__(self, make: Callable[[int], Iterator[Line]]) -> None:
        super().__init__(classes="dialog -wide")
        self.border_title = "Help: every key"
        self._make_lines = make
        self._made_for = 0

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """Return the number of lines in a width; else the box would be small at first, and be sent twice."""
        self._write_for(width)
        return len(self._lines)

    def on_resize(self) -> None:
        self._write_for(self.size.width)

    def _write_for(self, width: int) -> None:
        if width != self._made_for:
            self._made_for, self._lines = width, list(self._make_lines(width))


class HelpScreen(ModalScreen[None]):
    """Every key, first the keys of the screen `below`, on which the operator asks."""

    BINDINGS: ClassVar = [Binding("escape,q,question_mark,f1,enter", "dismiss", show=False)]

    def __init__(self, console: ConsoleShell, actions: Sequence[Action], below: Screen[Any]) -> None:
        super().__init__()
        self.console, self._actions = console, actions
        self._classes_below = {each.__name__ for each in type(below).__mro__}

    def compose(self) -> ComposeResult:
        yield KeyList(self._lines)

    def _lines(self, width: int) -> Iterator[Line]:
        room = max(20, width - KEYS_WIDTH - ID_WIDTH)
        shown = [action for action in self._actions if not (action.changes and self.console.readonly)]
        order = list(Group)
        # The fleet's screen opens none of these screens.
        chapters = () if any(action.group is Group.FLEET for action in shown) else KEYS_ON_SCREENS
        yield from self._chapters([each for each in chapters if each.screen in self._classes_below], room)
        for group, actions in groupby(sorted(shown, key=lambda a: order.index(a.group)), key=lambda a: a.group):
            yield ((group.value, "head"),)
            for action in actions:
                keys = "  ".join(self.console.key_labels(action))
                first, *more = textwrap.wrap(action.help, room - 2)
                where = OWN_KEYS if action.group is Group.OWN else action.id
                yield ((f"  {keys:<{KEYS_WIDTH - 2}}", "key"), (f"{first:<{room}}", ""), (where, "dim"))
                yield from (((" " * KEYS_WIDTH + text, ""),) for text in more)
            yield ()
        yield from self._chapters([each for each in chapters if each.screen not in self._classes_below], room)
        yield (("Other keys, one line each, like   pause: P", "dim"),)
        file = f"in {self.console.config / 'keys.yaml'}"
        yield from (((text, "dim"),) for text in textwrap.wrap(file, max(20, width)))

    def _chapters(self, chapters: Sequence[KeyChapter], room: int) -> Iterator[Line]:
        for chapter in chapters:
            yield ((chapter.title, "head"),)
            for pair in chapter.keys:
                keys, meaning = (spelled(text, ascii_only=self.app.ascii_only) for text in pair)  # type: ignore[attr-defined]
                first, *more = textwrap.wrap(meaning, room + ID_WIDTH - 2)
                yield ((f"  {keys:<{KEYS_WIDTH - 2}}", "key"), (first, ""))
                yield from (((" " * KEYS_WIDTH + text, ""),) for text in more)
            yield ()


def _closeness(action: Action, query: str) -> int:
    """Return 2 if an action's name begins with what is typed, 1 if a word about it does, 0 for scattered letters."""
    typed = query.casefold().strip()
    if any(name.casefold().startswith(typed) for name in (action.id, action.label)):
        return 2
    words = f" {action.help} {action.also}".casefold()
    return int(f" {typed}" in words)


@runtime_checkable
class LabelsKeys(Protocol):
    """An app that knows the keys of actions, as `rsb_console.console_api.Console` does."""

    actions: Sequence[Action]

    def key_labels(self, action: Action) -> list[str]:
        """Return the keys of an action, as written on a keyboard."""


class ActionsProvider(Provider):
    """Finds the actions that are possible now, and shows their keys."""

    def _possible(self) -> Iterator[Action]:
        assert isinstance(self.app, LabelsKeys)
        return (action for action in self.app.actions if self.screen.check_action(action.id, ()))

    async def discover(self) -> Hits:
        def by_use(action: Action) -> tuple[bool, bool]:
            """Sort the footer's actions first, and movements of the cursor last."""
            return action.group is Group.MOVE, not action.in_footer

        for action in sorted(self._possible(), key=by_use):
            yield DiscoveryHit(action.help, partial(self._run, action), help=self._keys(action))

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for action in self._possible():
            score = matcher.match(f"{action.help} {action.label} {action.also}")
            if score > 0:
                score += _FIRST * _closeness(action, query)
                yield Hit(score, matcher.highlight(action.help), partial(self._run, action), help=self._keys(action))

    def _keys(self, action: Action) -> str:
        assert isinstance(self.app, LabelsKeys)
        return "  ".join(self.app.key_labels(action))

    async def _run(self, action: Action) -> None:
        await self.app.run_action(f"{NAMESPACE[action.group]}.{action.id}")
