"""Choosing a session file from a list or by its path."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from textual import on
from textual.widgets import Button

from rsb_bridge.config.files import typed_path
from rsb_bridge.config.session_file import SessionError, load
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import ACTIONS
from rsb_console.session.recent_sessions import recent_sessions
from rsb_console.widgets.form import FormScreen, Spec
from rsb_console.widgets.lines import fit
from rsb_console.widgets.picker import PickField, Suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from textual.app import ComposeResult

    from rsb_bridge.model.session import Session

MORE = {
    **{action.id: action.begins.button for action in ACTIONS if action.begins and action.begins.button},
    "save": "Save",
    "save_as": "Save as…",
}


class FileText(Wording):
    """Advice on files that an operator may name."""

    EXISTS = "the file exists: enter picks it"
    MISSING = "missing: name the file"


class OpenedFile(NamedTuple):
    session: Session
    path: Path


def is_path(text: str) -> bool:
    """Whether a typed text is a path rather than a search."""
    return "/" in text or text.endswith((".yaml", ".yml"))


def yaml_files(*folders: Path) -> list[Path]:
    return sorted(path for folder in folders for path in folder.glob("*.y*ml") if path.is_file())


def suggestions(files: list[Path], what: str) -> Iterator[Suggestion]:
    """Yield suggestions of files, each with a word for their kind."""
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
    return FileText.EXISTS() if is_file(typed_path(text)) else "no such file; type its path"


class SessionsScreen(FormScreen[OpenedFile | str]):
    """Open a session, or choose another action, whose id it then returns.

    Args:
        path: first text of the field.
        runs: whether a session runs, and can be saved.
    """

    def __init__(self, path: str = "", *, runs: bool, readonly: bool) -> None:
        spec = Spec(
            "path",
            "Session",
            "Arrows and enter to open one of these, or type a path.",
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
