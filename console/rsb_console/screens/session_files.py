"""Choose a session file: the recent ones, those in the working folder, or any by its path."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from textual import on
from textual.widgets import Button

from rsb_bridge.config.files import typed_path
from rsb_bridge.config.session_file import SessionError, load
from rsb_console.screens.form import FormScreen
from rsb_console.session.recents import recent_sessions
from rsb_console.session.saving import path_problem
from rsb_console.widgets.form import Field, Spec
from rsb_console.widgets.lines import fit
from rsb_console.widgets.picker import PickField, Suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from textual.app import ComposeResult

    from rsb_bridge.model.session import Session

MORE = {"new_session": "New…", "import_session": "Import…", "save": "Save", "save_as": "Save as…"}


class Opened(NamedTuple):
    """A session and its file."""

    session: Session
    path: Path


def is_path(text: str) -> bool:
    """Whether what was typed is a path rather than something to look for."""
    return "/" in text or text.endswith((".yaml", ".yml"))


def yaml_files(*folders: Path) -> list[Path]:
    return sorted(path for folder in folders for path in folder.glob("*.y*ml") if path.is_file())


def suggestions(files: list[Path], what: str) -> Iterator[Suggestion]:
    """Files to pick from.

    Args:
        files: which.
        what: what they are, said of each.
    """
    for path in files:
        line = ((f"{path.name:<28} ", "strong"), (f"{what:<8} ", "dim"), (str(path.parent), "dim"))
        yield Suggestion(str(path.resolve()), str(path), partial(fit, line))


def is_file(path: Path) -> bool:
    """Whether a file is there, as far as one sees: a path that is being typed may be too long for one, or not ours."""
    try:
        return path.is_file()
    except OSError:
        return False


def no_suggestion(text: str) -> str:
    """What to say where none of the files offered is what was typed: a path need not be among them."""
    if not text:
        return "no YAML file here; type a path"
    path = typed_path(text)
    if is_file(path):
        return "the file exists: ⏎ picks it"
    return "no such file; type its path"


class SessionsScreen(FormScreen[Opened | str]):
    """Open a session, or go on to another way to get one: then gives the action's id.

    Args:
        path: to begin with.
        runs: a session runs, and can be saved.
        readonly: nothing may be changed.
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
        """The other ways, but for those that change nothing but files while read-only."""
        yield from super().compose_buttons()
        for action, label in MORE.items():
            if not self._readonly and (self._runs or not action.startswith("save")):
                yield Button(label, id=action, compact=True)

    def on_mount(self) -> None:
        super().on_mount()
        recent = recent_sessions()
        known = {path.resolve() for path in recent}
        here = [path for path in yaml_files(Path.cwd()) if path.resolve() not in known]
        self._field.suggest([*suggestions(recent, "recent"), *suggestions(here, "here")], no_suggestion)

    @on(PickField.Picked)
    def _picked(self, event: PickField.Picked) -> None:
        self.submit()

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        return {} if self.result(values) else {"path": "missing: name the file"}

    def result(self, values: Mapping[str, str]) -> str:
        """The path, picked or typed; `accept` makes a session of it."""
        picked = self._field.picked
        return values["path"] if picked is None else picked.value

    def accept(self, result: Opened | str) -> None:
        """Load it; what is wrong in it is said here, with the lines."""
        path = typed_path(str(result))
        try:
            self.dismiss(Opened(load(path), path))
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
        path: to begin with.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(
            "Save as",
            [Field(Spec("path", "File", "Key files are relative to its folder.", str(path), edited=True))],
            "Save",
        )

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """Whether a file can be there."""
        problem = path_problem(values["path"])
        return {"path": problem} if problem else {}

    def result(self, values: Mapping[str, str]) -> Path:
        return typed_path(values["path"])
