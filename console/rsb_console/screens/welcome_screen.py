"""The menu of all ways to begin."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_console.actions.action import Beginning
from rsb_console.actions.all_actions import ACTIONS, BY_ID
from rsb_console.screens.dialog import Dialog
from rsb_console.session.recent_sessions import recent_sessions
from rsb_console.widgets.lines import Line, fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from textual.app import ComposeResult

    from rsb_bridge.control.bridges import RunningBridge

ABOUT = """\
Bridges ROS 2 topics between domains and networks over encrypted sockets,
and shows which of them flow."""
_QUIT = Beginning("q", "Quit", "", 0, writes=False)
_BEGINNINGS = {action.id: action.begins for action in ACTIONS if action.begins}
CHOICES = {**dict(sorted(_BEGINNINGS.items(), key=lambda each: each[1].place)), "quit": _QUIT}
WATCHING = tuple(choice for choice, each in CHOICES.items() if not each.writes)
RECENT = 5  # sessions in the menu, each with a digit as its key


class Menu(SelectableList):
    """The menu: bridges that run on this machine, some of the `CHOICES`, the recent sessions, and quit."""

    def __init__(self, running: Sequence[RunningBridge], choices: Sequence[str], recent: Sequence[Path]) -> None:
        super().__init__(id="menu")
        self._lines: dict[str, Line] = {}
        for bridge in running:
            about = f"runs: {bridge.info.role}, {bridge.info.address}" if bridge.info else bridge.problem
            message = f"{about}, pid {bridge.pid}; enter attaches"
            self._lines[str(bridge.path)] = (("●  ", "ok"), (f"{bridge.name:<17}", "strong"), (message, "dim"))
        for choice in choices:
            each = CHOICES[choice]
            self._lines[choice] = ((f"{each.key}  ", "key"), (f"{each.label:<17}", "strong"), (each.about, "dim"))
        for number, path in enumerate(recent, start=1):
            self._lines[str(path)] = ((f"{number}  ", "key"), (f"{path.stem:<17}", "strong"), (str(path), "dim"))
        self._lines["quit"] = self._lines.pop("quit")  # last
        self.keys = list(self._lines)

    def line(self, index: int) -> Line:
        sign = "▌ " if self.is_cursor(index) else "  "
        return fit(((sign, "key"), *self._lines[self.keys[index]]), self.size.width)

    def on_mount(self) -> None:
        self.styles.height = self.line_count
        self.sync()


class WelcomeScreen(ModalScreen[str]):
    """Returns one of `CHOICES`, or the path of a running bridge's control socket or of a recent session."""

    BINDINGS: ClassVar = [
        Binding("enter", "choose", show=False),
        Binding("escape", "dismiss('')", show=False),
        *(
            # Also by the keys of the main screen, which the menu hides.
            Binding(",".join(filter(None, (each.key, BY_ID[choice].keys))), f"dismiss('{choice}')", show=False)
            for choice, each in CHOICES.items()
        ),
        *(Binding(str(number), f"select_recent({number})", show=False) for number in range(1, RECENT + 1)),
    ]

    def __init__(self, running: Sequence[RunningBridge], *, readonly: bool) -> None:
        super().__init__()
        self._readonly = readonly
        self._recent = recent_sessions()[:RECENT]
        self.menu = Menu(running, WATCHING if readonly else tuple(CHOICES), self._recent)

    def compose(self) -> ComposeResult:
        keys = "⏎ choose   ? every key" + ("" if self._readonly else "   esc close")
        yield Dialog("rsb-console", Static(ABOUT, classes="hint"), self.menu, keys=keys)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Allow only the menu's actions; a read-only console has no screen behind the menu to return to."""
        if action == "dismiss":
            return parameters[0] in self.menu.keys if parameters[0] else not self._readonly
        return super().check_action(action, parameters)

    def action_choose(self) -> None:
        self.dismiss(self.menu.cursor_key)

    def on_selectable_list_chosen(self) -> None:
        self.action_choose()

    def action_select_recent(self, number: int) -> None:
        """Put the cursor on a recent session. Enter starts it, as a single key must not start a bridge."""
        if number <= len(self._recent):
            self.menu.move_to(self.menu.keys.index(str(self._recent[number - 1])))
        else:
            self.notify(f"no recent session has the number {number}", timeout=3)
