"""Session files: choosing one in the welcome menu, from a list or by its path, and saving to one."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

from platformdirs import user_state_path
from textual import on
from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Static

from rsb_bridge.config.files import is_there, replace_file, typed_path
from rsb_bridge.config.keys import KeyFileError, copy_key
from rsb_bridge.config.session_file import SessionError, UneditableError, backup_path, edited_text, load, save
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import BY_ID
from rsb_console.screens.dialog import ConfirmScreen, Dialog
from rsb_console.session.saving import difference, file_of, moved, path_problem, rescued, text_of, unsaved
from rsb_console.widgets.form import Field, FormScreen, Spec
from rsb_console.widgets.lines import FixedLines, Line, clip, fit
from rsb_console.widgets.picker import PickField, Suggestion
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from textual.app import ComposeResult

    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.control.bridges import RunningBridge
    from rsb_bridge.model.session import Session
    from rsb_console.console_api import Console

LIMIT = 20  # sessions that are remembered; a round figure: the list has a filter
MORE = {"new_session": "New…", "import_session": "Import…", "save": "Save", "save_as": "Save as…"}
ABOUT = """\
Bridges ROS 2 topics between domains and networks over encrypted sockets,
and shows which of them flow."""
_DIFF_LOOKS = {"+": "ok", "-": "down", "@": "dim"}
_UNWRAPPED, _NARROWEST = 1 << 20, 10  # cells, before the first layout and after it


class FileText(Wording):
    """Advice on files that an operator may name."""

    EXISTS = "the file exists: ⏎ picks it"
    MISSING = "missing: name the file"
    SEVERAL_SESSIONS = "several sessions: run `rsb-console import {path} -o FOLDER`"
    RELATIVE_KEYS = "Key files are relative to its folder."


class SaveText(Wording):
    """Texts about saving a session."""

    KEY_SAVED = "its key is saved, too: {file}"
    KEY_NOT_SAVED = "The key is not saved"
    CHANGED_ON_DISK = "{file} was changed on disk"
    REWRITE = "Rewrite {file}?"
    REWRITTEN = "Its layout cannot be edited in place: the whole file is rewritten, without its comments"


CHOICES = {
    "demo": ("d", "Demo", "a simulated robot, bridged on this machine"),
    "new_session": ("n", "New session", "a form that creates the session file and the key"),
    "sessions": ("o", "Open a session", "a recent one, or any file"),
    "import_session": ("i", "Import", "a file of ros2_socket_bridge or zenoh-bridge-ros2dds"),
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
        return "no YAML file here; type a path"
    path = typed_path(text)
    if is_file(path):
        return FileText.EXISTS()
    return "no such file; type its path"


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


async def save_elsewhere(console: Console, session: Session, path: Path, opened: SessionFile | None) -> bool:
    """Save the running session to a file, perhaps in another folder.

    Args:
        console: console that runs the session. If the session is temporary, its keys are copied to the new file's
            folder.
        session: the running session; its key files are relative to `console.base`.
        opened: as for `save_asking`.

    Returns:
        Whether the file holds the session and its key files are there.
    """
    if not console.temporary:
        session = moved(session, console.base, path.parent)
        return await save_asking(console, session, path, opened=opened)
    try:
        # Keys go with the folder of a temporary session. They are copied last: a No leaves none behind.
        session, files = rescued(session, console.base, path.parent)
        if not await save_asking(console, session, path):
            return False
        for file, key in files.items():
            copy_key(key, file)
            console.notify(SaveText.KEY_SAVED(file=file), markup=False)
    except KeyFileError as error:
        console.notify(str(error), title=SaveText.KEY_NOT_SAVED(), severity="error", markup=False, timeout=15)
        return False
    return True


async def save_asking(console: Console, session: Session, path: Path, *, opened: SessionFile | None = None) -> bool:
    """Write a session file; ask before one is changed or replaced, and notify the operator of the outcome.

    Args:
        session: its key files are relative to the folder of `path`.
        path: path of the file, left alone if it holds the same session already.
        opened: the file that the session came from: its comments and layout are kept.

    Returns:
        Whether the file holds the session.
    """
    if file_of(path, session) is not None:
        console.notify(f"nothing to save: {path} is up to date", markup=False, timeout=3)
        return True
    try:
        edited, shown = opened, None
        # Again if somebody has written the file while the question stood, whose change the difference does not show.
        while is_there(path) and (present := text_of(path)) != shown:
            shown = present
            question, edited = _question(session, path, opened)
            if not await console.ask(question):
                return False
        save(session, path, edited)
    except SessionError as error:
        console.notify(str(error), title="Not saved", severity="error", markup=False, timeout=15)
        return False
    console.notify(f"saved: {path}", markup=False, timeout=3)
    return True


def _question(session: Session, path: Path, opened: SessionFile | None) -> tuple[ConfirmScreen, SessionFile | None]:
    """Return the question before a file is replaced, and the opened file to edit, or None to write the whole file.

    Raises:
        SessionError: the session has mistakes, or the file was changed on disk meanwhile.
    """
    title, yes, message = f"Overwrite {path.name}?", "Overwrite", "The present content of the file is replaced"
    if opened is not None and opened.is_at(path):
        opened.check_unchanged()
        title, yes = f"Save {path.name}?", "Save"
        message = f"Changes: {unsaved(opened.session, session)}. The rest of the file stays, comments too"
    try:
        after = edited_text(session, path, opened)
    except UneditableError:
        opened, after = None, edited_text(session, path)
        title, yes, message = SaveText.REWRITE(file=path.name), "Rewrite", SaveText.REWRITTEN()
    message = f"{message}. A backup is kept in {backup_path(path).name}."
    return DiffScreen(title, message, yes, difference(text_of(path), after)), opened


class DiffLines(FixedLines):
    """The lines of a diff, coloured; a long one goes on in the next line."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__(id="diff")
        self._diff = lines
        self._wrap(_UNWRAPPED)

    def on_resize(self) -> None:
        self._wrap(max(_NARROWEST, self.size.width))

    def _wrap(self, width: int) -> None:
        lines: list[Line] = []
        for text in self._diff:
            look, rest = _DIFF_LOOKS.get(text[:1], ""), text or " "
            while rest:
                piece = clip(rest, width)
                lines.append(((piece, look),))
                rest = rest[len(piece) :]
        self._lines, self.styles.height = lines, len(lines)


class DiffScreen(ConfirmScreen):
    """A question with the diff of a file.

    Args:
        message: consequences of a yes.
        yes: label of the button that agrees.
    """

    SHAPE = "-wide"

    def __init__(self, title: str, message: str, yes: str, lines: Sequence[str]) -> None:
        super().__init__(title, message, yes, Effect.LOSES)
        self._diff = DiffLines(lines)

    def compose_message(self) -> ComposeResult:
        yield from super().compose_message()
        yield self._diff


ChangedAnswer = Literal["reload", "overwrite", "save_as", ""]


class ChangedScreen(ModalScreen[ChangedAnswer]):
    """Offers the choices after a session's file was changed on disk; escape does nothing.

    Args:
        path: path of the file.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "dismiss('')", show=False),
        Binding("left", "app.focus_previous", show=False),
        Binding("right", "app.focus_next", show=False),
    ]
    AUTO_FOCUS = "#cancel"

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def compose(self) -> ComposeResult:
        """Compose the explanation and a button for each choice."""
        with Vertical(classes="dialog -wide") as dialog:
            dialog.border_title = SaveText.CHANGED_ON_DISK(file=self._path.name)
            yield Static(
                "The file was changed outside this console since it was opened.\n"
                "Reload: the bridge takes the file; unsaved changes here are lost.\n"
                "Overwrite: the file takes the bridge's present session.\n"
                "Save as: use another name; the file stays as it is.\n"
                "Reload and overwrite show the difference first.",
                markup=False,
            )
            with Horizontal(classes="buttons"):
                yield Button("Reload…", id="reload", compact=True)
                yield Button("Overwrite…", id="overwrite", variant="error", compact=True)
                yield Button("Save as…", id="save_as", compact=True)
                yield Button("Cancel", id="cancel", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        answers: dict[str | None, ChangedAnswer] = {
            "reload": "reload", "overwrite": "overwrite", "save_as": "save_as",
        }  # fmt: skip
        self.dismiss(answers.get(event.button.id, ""))
