"""Undoes adding and removing a server's clients on this console."""

from __future__ import annotations

import asyncio
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.api import EngineError
from rsb_bridge.config.client_entries import ClientError, client_named
from rsb_bridge.config.keys import KeyFileError
from rsb_bridge.config.session_file import SessionError
from rsb_bridge.model.operators import undoing
from rsb_console.session import clients
from rsb_console.session.changes import CannotUndoError, Change, Undo
from rsb_console.session.saving import is_changed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Client, Session
    from rsb_bridge.model.snapshot import Event, Snapshot
    from rsb_console.console import Console
    from rsb_console.session.clients import Changed


@dataclass(frozen=True, slots=True)
class _ClientChange(Change):
    """A client was added or removed.

    Attributes:
        console: the app.
        path: of the session file.
        listed: the client as the file has, or had, it.
        running: the client as the bridge has, or had, it.
    """

    _: KW_ONLY
    console: Console
    path: Path
    listed: Client
    running: Client

    def _change_file(self, change: Callable[[], Changed]) -> None:
        """Change the session file.

        Raises:
            EngineError: it cannot be changed.
        """
        is_known = self.console.file is not None and not is_changed(self.console.file)
        try:
            changed = change()
        except (ClientError, KeyFileError, SessionError) as error:
            raise EngineError(str(error)) from None
        if is_known:
            self.console.saved_to(changed.file.session, changed.file.path)

    def _is_running(self, name: str) -> bool:
        engine = self.console.engine
        return engine is not None and _client(engine.session, name) is not None


@dataclass(frozen=True, slots=True)
class ClientAdded(_ClientChange):
    """A client was added."""

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        name = self.listed.name
        current = None if self.console.engine is None else _client(self.console.engine.session, name)
        in_file = _client_in(self.path, name)
        if current is None or in_file is None:
            raise CannotUndoError(f"client {name}: removed since; nothing to undo")
        if msgspec.structs.replace(current, topics=self.running.topics) != self.running or in_file != self.listed:
            raise CannotUndoError(f"client {name}: changed since: to remove it, open the links (c)")

        async def act(engine: EngineApi) -> None:
            self._change_file(lambda: clients.remove_client(self.path, name))
            with undoing():
                future = engine.remove_client(name)
            await asyncio.wrap_future(future)

        lines = (
            f"removes {name} from the bridge and from {self.path.name}",
            "Its link closes at once, and it cannot connect again. Its key file stays.",
        )
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
        if self._is_running(name) or _client_in(self.path, name) is not None:
            raise CannotUndoError(f"client {name}: added again since; nothing to undo")
        if self.key_at is not None and not self.key_at.exists():
            raise CannotUndoError(
                f"client {name}: its key file {self.key_at} is gone: add the client again in the links (c)"
            )

        async def act(engine: EngineApi) -> None:
            self._change_file(lambda: clients.add_client(self.path, self.listed))
            with undoing():
                future = engine.add_client(self.running)
            await asyncio.wrap_future(future)

        key = "" if self.key_at is None else f", with the key in {self.key_at.name}"
        lines = (
            f"adds {name} to the bridge and to {self.path.name} again{key}",
            "It may connect again, and its topics cross. This arms nothing.",
        )
        return Undo(f"Undo the removal of the client {name}?", lines, "Add again", True, act)


def _client(session: Session, name: str) -> Client | None:
    try:
        return client_named(session, name)
    except ClientError:
        return None


def _client_in(path: Path, name: str) -> Client | None:
    try:
        return _client(clients.open_server(path).session, name)
    except (ClientError, SessionError) as error:
        raise CannotUndoError(f"client {name}: {error}") from None
