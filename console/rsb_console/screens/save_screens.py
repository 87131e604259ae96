"""Saving a session to a file: its name, the difference before it is replaced, and what to do if others changed it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Static

from rsb_bridge.config.files import is_there, typed_path
from rsb_bridge.config.keys import KeyFileError, copy_key
from rsb_bridge.config.session_file import SessionError, UneditableError, backup_path, edited_text, save
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.wording import Wording
from rsb_console.screens.dialog import ConfirmScreen, suit_size
from rsb_console.session.saving import difference, file_of, moved, path_problem, rescued, text_of, unsaved
from rsb_console.widgets.form import Field, FormScreen, Spec
from rsb_console.widgets.lines import FixedLines, Line, clip

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual import events
    from textual.app import ComposeResult

    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.model.session import Session
    from rsb_console.console_api import Console

_DIFF_LOOKS = {"+": "ok", "-": "down", "@": "dim"}
_UNWRAPPED, _NARROWEST = 1 << 20, 10  # cells, before the first layout and after it


class SaveText(Wording):
    """Texts about saving a session."""

    RELATIVE_KEYS = "Key files are relative to its folder."
    KEY_SAVED = "its key is saved, too: {file}"
    KEY_NOT_SAVED = "The key is not saved"
    CHANGED_ON_DISK = "{file} was changed on disk"
    REWRITE = "Rewrite {file}?"
    REWRITTEN = "Its layout cannot be edited in place: the whole file is rewritten, without its comments"


class SaveAsScreen(FormScreen[Path]):
    """Name a file to save to; `path` is the first text of the field."""

    def __init__(self, path: Path) -> None:
        spec = Spec("path", "File", SaveText.RELATIVE_KEYS(), str(path), edited=True)
        super().__init__("Save as", [Field(spec)], "Save")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        problem = path_problem(values["path"])
        return {"path": problem} if problem else {}

    def result(self, values: Mapping[str, str]) -> Path:
        return typed_path(values["path"])


async def save_elsewhere(console: Console, session: Session, path: Path, opened: SessionFile | None) -> bool:
    """Save the console's session to a file, perhaps in another folder; a temporary session's keys are copied there.

    Args:
        session: its key files are relative to `console.base`.
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
    """Write a session file unless it is up to date; ask before one is changed or replaced, and notify the operator.

    Args:
        session: its key files are relative to the folder of `path`.
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
    """Return the question before a file is replaced, and the opened file to edit, or None to write the whole file."""
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
    """A question with the diff of a file."""

    SHAPE = "-wide"

    def __init__(self, title: str, message: str, yes: str, lines: Sequence[str]) -> None:
        super().__init__(title, message, yes, Effect.LOSES)
        self._diff = DiffLines(lines)

    def compose_message(self) -> ComposeResult:
        yield from super().compose_message()
        yield self._diff


ChangedAnswer = Literal["reload", "overwrite", "save_as", ""]


class ChangedScreen(ModalScreen[ChangedAnswer]):
    """Offers the choices after a session's file was changed on disk; escape does nothing."""

    BINDINGS: ClassVar = [
        Binding("escape", "dismiss('')", show=False),
        Binding("left,up", "app.focus_previous", show=False),
        Binding("right,down", "app.focus_next", show=False),
    ]
    AUTO_FOCUS = "#cancel"

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._scrolled = VerticalScroll(classes="message", can_focus=False)

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -wide") as dialog:
            title = SaveText.CHANGED_ON_DISK(file=self._path.name)
            dialog.border_title = Content(title)
            yield Static(title, classes="title", markup=False)
            with self._scrolled:
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

    def on_resize(self, event: events.Resize) -> None:
        suit_size(self, self._scrolled, event.size)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        answers: tuple[ChangedAnswer, ...] = ("reload", "overwrite", "save_as")
        self.dismiss(next((each for each in answers if each == event.button.id), ""))
