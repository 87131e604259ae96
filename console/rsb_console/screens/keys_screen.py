"""The session's key files: fingerprint, mode, and a new key. A key itself is never drawn."""

from __future__ import annotations

import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from textual import work
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_bridge.config.files import typed_path
from rsb_bridge.config.keys import (
    DEFAULT_KEY_FILE,
    KeyFileError,
    fingerprint,
    key_path,
    key_users,
    read_key,
    write_key,
    written,
)
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.screens.dialog import ConfirmScreen, Dialog
from rsb_console.session.saving import path_problem
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.form import Field, FormScreen, Notice, Spec
from rsb_console.widgets.lines import Line, fit
from rsb_console.widgets.selectable_list import SelectableList

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from textual.app import ComposeResult

    from rsb_bridge.model.session import Session
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen

NAME_WIDTH = 30


class KeyText(Wording):
    """Texts about key files."""

    ELSEWHERE = "{name} runs on another machine, or as another user: look at its key files there."
    IN_USE = "in use by a link, written {when}"
    WRITTEN = "written {when}"
    REPLACE = "Replace the key in {file}?"
    REPLACE_MEANS = "The old key is lost. A peer that holds only the old key can no longer link."


class KeyFile(NamedTuple):
    """The facts about a key file."""

    path: Path
    user: str  # a client, an operator or the session
    mode: str  # "0600", or empty if the file is missing
    fingerprint: str  # empty if the file cannot be read
    written: str  # in words
    note: str  # advice for an operator


def facts_of(path: Path, user: str, used_by: Sequence[str], now: float) -> KeyFile:
    """Read the facts about a key file at `now` (s since the epoch); links use the fingerprints `used_by`."""
    # Apart from the key: a file that cannot be read has a mode, which may be why.
    try:
        mode = f"{stat.S_IMODE(path.stat().st_mode):04o}"
    except OSError:
        mode = ""
    try:
        key = read_key(path)
    except KeyFileError as error:
        return KeyFile(path, user, mode, "", "", str(error))
    mark = fingerprint(key)
    use = KeyText.IN_USE if mark in used_by else KeyText.WRITTEN
    return KeyFile(path, user, mode, mark, use(when=written(key, now)), "\n".join(key.warnings))


def key_files(session: Session, base: Path) -> dict[Path, str]:
    """Return the user of each of a session's key files, which are relative to the folder `base`."""
    found: dict[Path, str] = {}
    for name, user in key_users(session).items():
        path = key_path(base, name)
        found[path] = f"{found[path]}, {user}" if path in found else user
    return found


class KeysTable(SelectableList):
    sticky = 1

    def __init__(self) -> None:
        super().__init__(id="keyfiles")
        self._files: dict[str, KeyFile] = {}

    def show(self, files: Sequence[KeyFile]) -> None:
        self._files = {str(file.path): file for file in files}
        self.show_keys(list(self._files))
        self.styles.height = max(2, min(self.line_count, 12))

    @property
    def selected(self) -> KeyFile | None:
        return None if self.cursor_key is None else self._files[self.cursor_key]

    def line(self, index: int) -> Line:
        if index < self.sticky:
            return ((f"   {'FILE':<{NAME_WIDTH}} {'MODE':<5} {'FINGERPRINT':<20} FOR", "head"),)
        file = self._files[self.keys[index - self.sticky]]
        sign, look = ("✗", "down") if not file.fingerprint else ("▲", "stale") if file.note else ("✓", "ok")
        name = fit(((f"{file.path.name:<{NAME_WIDTH}}", "strong"),), NAME_WIDTH)
        figures = f" {file.mode or '-':<5} {file.fingerprint or 'no key':<20} {file.user}"
        cursor = ("▌" if self.is_cursor(index) else " ", "key")
        return fit((cursor, (f"{sign} ", look), *name, (figures, "")), self.size.width)


class KeysScreen(ModalScreen[None]):
    """The session's key files; `g` creates a key."""

    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss", show=False),
        Binding("g", "generate", show=False, priority=True),  # to the table, g means the first line
    ]

    def __init__(self, console: Console) -> None:
        super().__init__()
        self.console = console
        self.table = KeysTable()
        self._written = Static(id="key-written", markup=False)
        self._note = Notice("problem", id="key-note")
        self._made: dict[Path, str] = {}

    def compose(self) -> ComposeResult:
        generate = "" if self.console.readonly else "g generate a key   "
        keys = f"Both sides of a link need the same fingerprint.\n{generate}esc close"
        yield Dialog("Key files", self.table, self._written, self._note, keys=keys)

    def on_mount(self) -> None:
        self.refresh_table()

    def refresh_table(self) -> None:
        engine, now = self.console.engine, time.time()
        links = () if engine is None else engine.snapshot().links
        used = [link.fingerprint for link in links if link.state is State.OK]
        files = self._made
        # A bridge elsewhere has other files under these names, and another user's may name any.
        if engine is not None and engine.trusted:
            files = files | key_files(engine.session, self.console.base)
        self.table.show([facts_of(path, user, used, now) for path, user in files.items()])
        self.on_selectable_list_cursor_moved()

    def on_selectable_list_cursor_moved(self) -> None:
        file, engine = self.table.selected, self.console.engine
        if file is not None:
            note = file.note
        elif engine is not None and not engine.trusted:
            note = KeyText.ELSEWHERE(name=engine.session.name)
        else:
            note = "No key file yet." if self.console.readonly else "No key file yet: g makes one."
        self._note.set_text(note)
        self._written.update("" if file is None else file.written)

    @work(group=DIALOG)
    async def action_generate(self) -> None:
        if self.console.readonly:
            return
        file = self.table.selected
        first = Path(DEFAULT_KEY_FILE) if file is None else file.path
        path = await self.console.ask(GenerateScreen(self.console, first))
        if path is not None:
            self._made.setdefault(path, "not in the session")
            self.refresh_table()
            self.table.move_to(self.table.keys.index(str(path)))


class GenerateScreen(FormScreen[Path]):
    """A form that creates a key and returns its file; `path` is the first text of the field."""

    def __init__(self, console: Console, path: Path) -> None:
        self.console = console
        advice = "Mode 0600. Copy it to the other side over a safe channel, and keep it secret."
        super().__init__("Generate a key", [Field(Spec("path", "File", advice, str(path), edited=True))], "Generate")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        problem = path_problem(values["path"])
        return {"path": problem} if problem else {}

    def result(self, values: Mapping[str, str]) -> Path:
        return typed_path(values["path"])

    @work(group=DIALOG)
    async def accept(self, result: Path) -> None:
        """Write the key; overwrite another only after a yes."""
        exists = result.exists()  # noqa: ASYNC240 -- one stat
        if exists:
            title, means = KeyText.REPLACE(file=result.name), KeyText.REPLACE_MEANS()
            if not await self.console.ask(ConfirmScreen(title, means, "Replace", Effect.LOSES)):
                return
        try:
            # A file that has come meanwhile is not overwritten, as nobody has agreed to that.
            key = write_key(result, force=exists)
        except KeyFileError as error:
            self.form.show_problems({"path": str(error)})
            return
        self.notify(
            f"{result}: fingerprint {fingerprint(key)}. A running session uses it after a reload (f6).",
            title="A new key", markup=False, timeout=10,
        )  # fmt: skip
        self.dismiss(result)


async def show_keys(screen: MainScreen) -> None:
    await screen.console.ask(KeysScreen(screen.console))
