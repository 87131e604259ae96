"""Choosing a session: the welcome menu, the recent files, those in the working folder, or any by its path."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from platformdirs import user_state_path
from textual import on
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Button, Static

from rsb_bridge.config.files import replace_file, typed_path
from rsb_bridge.config.session_file import SessionError, load
from rsb_bridge.model.wording import Wording
from rsb_console.actions import BY_ID
from rsb_console.screens.dialog import Dialog
from rsb_console.session.saving import path_problem
from rsb_console.widgets.form import Field, FormScreen, Spec
from rsb_console.widgets.lines import Line, fit
from rsb_console.widgets.picker import PickField, Suggestion
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from textual.app import ComposeResult

    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.session import Session

LIMIT = 20  # sessions that are remembered; a round figure: the list has a filter
MORE = {"new_session": "New…", "import_session": "Import…", "save": "Save", "save_as": "Save as…"}
ABOUT = """\
Bridges ROS 2 topics between domains and networks over encrypted sockets,
and shows which of them flow."""


class FileText(Wording):
    """Advice on files that an operator may name."""

    NONE_HERE = "no YAML file here; type a path"
    EXISTS = "the file exists: ⏎ picks it"
    NOT_FOUND = "no such file; type its path"
    MISSING = "missing: name the file"
    RELATIVE_KEYS = "Key files are relative to its folder."


CHOICES = {
    "demo": ("d", "Demo", "a simulated robot, bridged on this machine"),
    "new_session": ("n", "New session", "a form that creates the session file and the key"),
    "sessions": ("o", "Open a session", "a recent one, or any file"),
    "import_session": ("i", "Import", "a bringup.yaml of the thesis's ros2_socket_bridge"),
    "quit": ("q", "Quit", ""),
}
WATCHING = ("demo", "sessions", "quit")
RECENT = 5  # sessions in the menu, each with a digit as its key


def recents_path() -> Path:
    return user_state_path("rsb-console") / "recent-sessions"


def recent_sessions() -> list[Path]:
    """Return the recent session files that still exist, the newest first."""
    try:
        lines = recents_path().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    return [path for line in lines if (path := Path(line)).is_file()]


def remember(path: Path) -> None:
    """Put a session file first.

    Raises:
        OSError: the list could not be written.
    """
    # A relative path would mean another file in another folder.
    path = path.resolve()
    newest = [path, *(other for other in recent_sessions() if other != path)][:LIMIT]
    recents_path().parent.mkdir(parents=True, exist_ok=True)
    replace_file(recents_path(), "".join(f"{each}\n" for each in newest).encode())


class OpenedFile(NamedTuple):
    session: Session
    path: Path


def is_path(text: str) -> bool:
    """Whether a typed text is a path rather than a search."""
    return "/" in text or text.endswith((".yaml", ".yml"))


def yaml_files(*folders: Path) -> list[Path]:
    return sorted(path for folder in folders for path in folder.glob("*.y*ml") if path.is_file())


def suggestions(files: list[Path], what: str) -> Iterator[Suggestion]:
    """Yield suggestions of files.

    Args:
        what: word for their kind, shown with each.
    """
    for path in files:
        line = ((f"{path.name:<28} ", "strong"), (f"{what:<8} ", "dim"), (str(path.parent), "dim"))
        yield Suggestion(str(path.resolve()), str(path), partial(fit, line))


def is_file(path: Path) -> bool:
    """Whether a file is visible; a path that is being typed may be too long or inaccessible."""
    try:
        return path.is_file()
    except OSError:
        return False


def no_suggestion(text: str) -> str:
    """Return the text for a typed path or name that is not among the offered files."""
    if not text:
        return FileText.NONE_HERE()
    path = typed_path(text)
    if is_file(path):
        return FileText.EXISTS()
    return FileText.NOT_FOUND()


class SessionsScreen(FormScreen[OpenedFile | str]):
    """Open a session, or choose another action, whose id it then returns.

    Args:
        path: first text of the field.
        runs: a session runs, and can be saved.
    """

    def __init__(self, path: str = "", *, runs: bool, readonly: bool) -> None:
        spec = Spec(
            "path",
            "Session",
            "↑ ↓ and ⏎ to open one of these, or type a path.",
            path,
            blank="type to look for a file",
            edited=True,
        )
        self._field = PickField(spec, is_path)
        super().__init__("Sessions", [self._field], "Open")
        self._runs, self._readonly = runs, readonly

    def compose_buttons(self) -> ComposeResult:
        """Compose the other choices; while read-only, leave out the ones that only write files."""
        yield from super().compose_buttons()
        for action, label in MORE.items():
            if not self._readonly and (self._runs or not action.startswith("save")):
                yield Button(label, id=action, compact=True)

    def on_mount(self) -> None:
        recent = recent_sessions()
        known = {path.resolve() for path in recent}
        here = [path for path in yaml_files(Path.cwd()) if path.resolve() not in known]
        self._field.suggest([*suggestions(recent, "recent"), *suggestions(here, "here")], no_suggestion)

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        self.submit()

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        return {} if self.result(values) else {"path": FileText.MISSING()}

    def result(self, values: Mapping[str, str]) -> str:
        """Return the picked or typed path; `accept` loads its session."""
        picked = self._field.picked
        return values["path"] if picked is None else picked.value

    def accept(self, result: OpenedFile | str) -> None:
        """Load the session; show its mistakes here, with the lines."""
        path = typed_path(str(result))
        try:
            self.dismiss(OpenedFile(load(path), path))
        except SessionError as error:
            self.form.show_problems({"path": str(error)})

    def press(self, button: str) -> None:
        if button in MORE:
            self.dismiss(button)
        else:
            super().press(button)


class SaveAsScreen(FormScreen[Path]):
    """Name a file to save to.

    Args:
        path: first text of the field.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(
            "Save as",
            [Field(Spec("path", "File", FileText.RELATIVE_KEYS(), str(path), edited=True))],
            "Save",
        )

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """Whether a file can be there."""
        problem = path_problem(values["path"])
        return {"path": problem} if problem else {}

    def result(self, values: Mapping[str, str]) -> Path:
        return typed_path(values["path"])


class Menu(SelectableList):
    """The menu: bridges that run on this machine, the choices, the recent sessions, and quit.

    Args:
        running: bridges to attach to.
        choices: ids from `CHOICES`.
    """

    def __init__(self, running: Sequence[RunningBridge], choices: Sequence[str], recent: Sequence[Path]) -> None:
        super().__init__(id="menu")
        self._lines: dict[str, Line] = {}
        for bridge in running:
            about = f"runs: {bridge.info.role}, {bridge.info.address}" if bridge.info else bridge.problem
            message = f"{about}, pid {bridge.pid}; ⏎ attaches"
            self._lines[str(bridge.path)] = (("●  ", "ok"), (f"{bridge.name:<17}", "strong"), (message, "dim"))
        for choice in choices:
            key, label, more = CHOICES[choice]
            self._lines[choice] = ((f"{key}  ", "key"), (f"{label:<17}", "strong"), (more, "dim"))
        for number, path in enumerate(recent, start=1):
            self._lines[str(path)] = ((f"{number}  ", "key"), (f"{path.stem:<17}", "strong"), (str(path), "dim"))
        self._lines["quit"] = self._lines.pop("quit")  # last
        self.keys = list(self._lines)

    def line(self, index: int) -> Line:
        sign = "▌ " if self.is_cursor(index) else "  "
        return fit(((sign, "key"), *self._lines[self.keys[index]]), self.size.width)

    def on_mount(self) -> None:
        """Set the height to the number of lines."""
        self.styles.height = self.line_count
        self.sync()


class WelcomeScreen(ModalScreen[str]):
    """Returns one of `CHOICES`, or the path of a running bridge's control socket or of a recent session.

    Args:
        running: bridges on this machine.
        readonly: leave out what changes something.
    """

    BINDINGS: ClassVar = [
        Binding("enter", "choose", show=False),
        Binding("escape", "dismiss('')", show=False),
        *(
            # Also by the keys of the main screen, which the menu hides.
            Binding(f"{key},{BY_ID[choice].keys}", f"dismiss('{choice}')", show=False)
            for choice, (key, _, _) in CHOICES.items()
        ),
        *(Binding(str(number), f"select_recent({number})", show=False) for number in range(1, RECENT + 1)),
    ]

    def __init__(self, running: Sequence[RunningBridge], *, readonly: bool) -> None:
        super().__init__()
        self._readonly = readonly
        self._recent = recent_sessions()[:RECENT]
        self.menu = Menu(running, WATCHING if readonly else tuple(CHOICES), self._recent)

    def compose(self) -> ComposeResult:
        """Compose the title and the menu."""
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
