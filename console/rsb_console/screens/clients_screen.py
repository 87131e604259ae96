"""A server's clients: adding and removing them while it runs, undoing that, and the handout for each robot."""

from __future__ import annotations

import asyncio
import re
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import msgspec
from textual.binding import Binding
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Static

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import is_there
from rsb_bridge.config.grants import GrantError, typed_grants
from rsb_bridge.config.keys import KeyFileError, fingerprint
from rsb_bridge.config.session_changes import ClientError, client_named, with_client
from rsb_bridge.config.session_file import SessionError, validate
from rsb_bridge.model.commands import AddClient, Effect, RemoveClient, undoing
from rsb_bridge.model.session import Client, Grant
from rsb_bridge.model.wording import Wording
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.session import client_files
from rsb_console.session.changes import CannotUndoError, Change, Undo
from rsb_console.session.saving import is_changed
from rsb_console.terminal.driver import copy
from rsb_console.widgets.form import Field, FormScreen, Spec
from rsb_console.widgets.key_hints import KeyHints

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from textual.app import ComposeResult

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.commands import Command
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Event, Snapshot
    from rsb_console.console_api import Console
    from rsb_console.session.client_files import ChangedFile

_BETWEEN = re.compile(r"[\s,]+")
PREFIXES = (("", "as the server's"), ("yes", "yes"), ("no", "no"))
FIELDS = (
    Spec("name", "Name", "As in the client's own session: robot2."),
    Spec("key_file", "Key file", "In the session's folder. Empty: a new one. An existing file is used as it is.",
         blank="a new one"),
    Spec("use_name", "Prefix", "Its topics here have its name as a prefix: /robot2/scan.", options=PREFIXES),
    Spec("allow", "Allowed", "Patterns of the topics that it may bridge, like /camera/*. Empty: all.", blank="all"),
    Spec("deny", "Denied", "Patterns of the topics that it may not bridge; overrides Allowed.", blank="none"),
)  # fmt: skip


class ClientText(Wording):
    """Texts about a server's clients."""

    EXISTS = "is a client already"
    UNDO_REMOVAL = "Undo the removal of the client {name}?"


@dataclass(frozen=True, slots=True)
class _ClientChange(Change):
    """A client was added or removed.

    Attributes:
        path: path of the session file.
        listed: the client as the file has, or had, it.
        running: the client as the bridge has, or had, it.
    """

    _: KW_ONLY
    console: Console
    path: Path
    listed: Client
    running: Client

    def _present(self) -> Client | None:
        engine = self.console.engine
        return None if engine is None else _client(engine.session, self.listed.name)

    async def _undo(self, change: Callable[[], ChangedFile], command: Command[None], engine: EngineApi) -> None:
        try:
            _change_file(self.console, change)
        except (ClientError, KeyFileError, SessionError) as error:
            raise EngineError(str(error)) from None
        with undoing():
            future = engine.do(command)
        await asyncio.wrap_future(future)


@dataclass(frozen=True, slots=True)
class ClientAdded(_ClientChange):
    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        name = self.listed.name
        current, in_file = self._present(), _client_in(self.path, name)
        if current is None or in_file is None:
            raise CannotUndoError(f"client {name}: removed meanwhile; nothing to undo")
        # Topics that were added to it since are no change of the client.
        if msgspec.structs.replace(current, topics=self.running.topics) != self.running or in_file != self.listed:
            raise CannotUndoError(f"client {name}: changed meanwhile: to remove it, open the links (c)")
        lines = (
            f"removes {name} from the bridge and from {self.path.name}",
            "Its link closes at once, and it cannot connect again. Its key file stays.",
        )
        act = partial(self._undo, partial(client_files.remove_client, self.path, name), RemoveClient(name))
        return Undo(f"Undo the addition: remove the client {name}?", lines, "Remove", True, act)


@dataclass(frozen=True, slots=True)
class ClientRemoved(_ClientChange):
    """A client was removed.

    Attributes:
        key_at: its key file, or None without encryption.
    """

    _: KW_ONLY
    key_at: Path | None

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        name = self.listed.name
        if self._present() is not None or _client_in(self.path, name) is not None:
            raise CannotUndoError(f"client {name}: added again meanwhile; nothing to undo")
        # Without its key file, adding it would make a new key, which the robot does not have.
        if self.key_at is not None and not is_there(self.key_at):
            raise CannotUndoError(
                f"client {name}: its key file {self.key_at} is gone: add the client again in the links (c)"
            )
        key = "" if self.key_at is None else f", with the key in {self.key_at.name}"
        lines = (
            f"adds {name} to the bridge and to {self.path.name} again{key}",
            "It may connect again, and its topics cross. This arms nothing.",
        )
        act = partial(self._undo, partial(client_files.add_client, self.path, self.listed), AddClient(self.running))
        return Undo(ClientText.UNDO_REMOVAL(name=name), lines, "Add again", True, act)


def _client(session: Session, name: str) -> Client | None:
    try:
        return client_named(session, name)
    except ClientError:
        return None


def _client_in(path: Path, name: str) -> Client | None:
    try:
        return _client(client_files.open_server(path).session, name)
    except (ClientError, SessionError) as error:
        raise CannotUndoError(f"client {name}: {error}") from None


def words(text: str) -> tuple[str, ...]:
    """Return the words of a field, with blanks or commas between them."""
    return tuple(word for word in _BETWEEN.split(text) if word)


async def add_client(console: Console) -> None:
    """Ask for a client, add it to the session file, let the bridge have it, and show what the robot needs."""
    path = _saved_path(console)
    if path is None or console.engine is None:
        return
    client = await console.ask(AddClientScreen(console.engine.session, path.parent))
    if client is None:
        return
    try:
        changed = _change_file(console, partial(client_files.add_client, path, client))
    except (ClientError, KeyFileError, SessionError) as error:
        console.notify(str(error), title="Not added", severity="error", markup=False, timeout=15)
        return
    if await console.command(console.engine.add_client(changed.client)):
        console.changes.add(
            ClientAdded(client.name, client.name, 0, console=console, path=path, listed=changed.client,
                        running=changed.client)
        )  # fmt: skip
    # Also if the bridge has refused: the file is changed.
    await console.ask(HandoutScreen(f"{client.name} is added", (changed,)))


async def remove_client(console: Console, name: str) -> None:
    """Ask, then remove a client from the session file and from the bridge."""
    path = _saved_path(console)
    if path is None or console.engine is None:
        return
    message = (
        "Its link is closed at once, and it can no longer connect. The other clients stay linked. "
        "Its key file stays; the client's own files are not touched."
    )
    if not await console.ask(ConfirmScreen(f"Remove the client {name}?", message, "Remove", Effect.LOSES)):
        return
    try:
        running = client_named(console.engine.session, name)
        changed = _change_file(console, partial(client_files.remove_client, path, name))
    except (ClientError, SessionError) as error:
        console.notify(str(error), title="Not removed", severity="error", markup=False, timeout=15)
        return
    if await console.command(console.engine.remove_client(name), f"{name}: removed"):
        console.changes.add(
            ClientRemoved(name, name, 0, console=console, path=path, listed=changed.client, running=running,
                          key_at=changed.key_path)
        )  # fmt: skip


def _saved_path(console: Console) -> Path | None:
    """Return the file of the server's session, or notify the operator if it has no file."""
    if console.path is None or console.temporary:
        console.notify("save the session first (w): its file lists the clients", severity="warning", timeout=8)
        return None
    return console.path


def _change_file(console: Console, change: Callable[[], ChangedFile]) -> ChangedFile:
    """Change the session file, and go on with it; if others changed it, too, the next save still reports that.

    Raises:
        ClientError, KeyFileError, SessionError: it cannot be changed.
    """
    # Asked before the change, after which the file differs in any case.
    is_known = console.file is not None and not is_changed(console.file)
    changed = change()
    if is_known:
        console.saved_to(changed.file.session, changed.file.path)
    return changed


class AddClientScreen(FormScreen[Client]):
    """Describe a client, whose key file is relative to the folder `base`."""

    def __init__(self, session: Session, base: Path) -> None:
        super().__init__("Add a client", [Field(spec) for spec in FIELDS], "Add")
        self._session, self._base = session, base

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        """Check the client by the session file's rules."""
        # First: `result` leaves out grants that have a mistake.
        for key in ("allow", "deny"):
            try:
                typed_grants(values[key])
            except GrantError as error:
                return {key: str(error)}
        client = self.result(values)
        if not client.name:
            return {"name": "missing: give one"}
        try:
            session = with_client(self._session, client_files.with_key_file(self._session, client))
        except ClientError:
            return {"name": ClientText.EXISTS()}
        problems: dict[str, str] = {}
        # The new one is the last. Mistakes elsewhere in the session are not this form's.
        here = f"clients[{len(session.listed_clients) - 1}]."
        for problem in validate(session):
            if problem.location.startswith(here):
                field = problem.location.removeprefix(here).partition("[")[0]
                problems.setdefault(field, problem.message)
        if not client.key_file and is_there(self._base / client_files.key_file_name(client.name)):
            problems["key_file"] = f"{client_files.key_file_name(client.name)} exists already: name it here to use it"
        return problems

    def result(self, values: Mapping[str, str]) -> Client:
        return Client(
            name=values["name"],
            key_file=values["key_file"] or None,
            use_name={"yes": True, "no": False}.get(values["use_name"]),
            allow=_grants(values["allow"]),
            deny=_grants(values["deny"]),
        )


def _grants(text: str) -> tuple[str | Grant, ...]:
    """Return the grants in a field, or nothing while it has a mistake."""
    try:
        return typed_grants(text)
    except GrantError:
        return ()


class HandoutScreen(ModalScreen[None]):
    """The files that each new client needs: its session file to copy from here, and its key."""

    BINDINGS: ClassVar = [Binding("escape,q,enter", "dismiss", show=False), Binding("y", "copy", show=False)]

    def __init__(self, title: str, handed: Sequence[ChangedFile]) -> None:
        super().__init__()
        self._title = title
        self._handed = handed

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -wide") as dialog:
            dialog.border_title = Content(self._title)
            with VerticalScroll(classes="handout"):
                for changed in self._handed:
                    yield Static(self._about(changed), markup=False)
            yield KeyHints("y copy the session files   ↑ ↓ scroll   esc close")

    def _about(self, changed: ChangedFile) -> str:
        mark = "" if changed.key is None else f"key {changed.key_path}, fingerprint {fingerprint(changed.key)}\n"
        advice = client_files.copy_advice(changed.client, changed.key_path)
        return f"{_robot_text(changed)}\n{mark}For {changed.client.name}: {advice}.\n"

    def action_copy(self) -> None:
        copy(self.app, "\n".join(map(_robot_text, self._handed)))
        self.notify("the session files are copied", timeout=3)


def _robot_text(changed: ChangedFile) -> str:
    return client_files.robot_file(changed.file.session, changed.client)
