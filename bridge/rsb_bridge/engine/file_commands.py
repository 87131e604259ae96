"""Commands that read or write files: about a server's clients, whose keys are in files, about reloads and saves."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, TypeVar

import msgspec

from rsb_bridge.api import EngineError, Unable
from rsb_bridge.config.session_changes import (
    client_named,
    is_another,
    kept,
    with_changed_client,
    with_client,
    without_client,
)
from rsb_bridge.config.session_file import (
    SessionError,
    SessionInFile,
    demand_places,
    load_file,
    open_file,
    same,
    save,
)
from rsb_bridge.config.validation import validate
from rsb_bridge.engine.access import load_keys
from rsb_bridge.engine.part import EnginePart
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddClient, ChangeClient, Reload, RemoveClient, Save, operator
from rsb_bridge.model.snapshot import Level, Reloaded
from rsb_bridge.tasks import in_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.engine.access import Access
    from rsb_bridge.engine.bridge import Bridge
    from rsb_bridge.model.demands import SourceKey
    from rsb_bridge.model.session import Client, Session

_READ_WITHIN = 10.0
"""s in which the session's files have to be read: so much longer, other changes wait at most. A round figure."""

T = TypeVar("T")


async def _read(work: Callable[[], T]) -> T:
    """Read files on a thread; not on the loop's own, as a network folder may never answer.

    Raises:
        EngineError: they are not read in time.
    """
    try:
        return await in_thread("rsb-read", work, _READ_WITHIN)
    except TimeoutError:
        raise EngineError(Unable.DISK_SILENT(seconds=_READ_WITHIN)) from None


class EngineFile:
    """The session that an engine has started with, or has read again, and its file.

    Attributes:
        base: the folder that the session's key files are relative to.
        path: of the file, or None if the session is in none.
        opened: the file as it was read or saved last, or None if it had mistakes then.
        contents: what the file holds, next to the running session.
        places: the lines of the file that demand arming or limits.
    """

    def __init__(self, session: Session, base: Path) -> None:
        self.session, self.base = session, base
        self.path: Path | None = None
        self.opened: SessionFile | None = None
        self.contents = SessionInFile()
        self.places: Mapping[SourceKey, str] = {}

    def use(self, path: Path | None, holds: Session) -> None:
        """Read and save that file from now on, which holds a session; or none."""
        self.path = path
        self.opened = None if path is None else open_file(path)
        self.contents.session = None if path is None else holds
        self.contents.name = "" if path is None else path.name
        self.places = {} if path is None else demand_places(path)

    def folder(self) -> Path:
        return self.base if self.path is None else self.path.parent

    def read_again(self) -> tuple[SessionFile, Session, list[str]]:
        """Read the file: as it is, the session to change to, and the differences that cannot take effect.

        Raises:
            EngineError: the session is in no file, or the file has mistakes.
        """
        if self.path is None:
            raise EngineError(Unable.NO_FILE())
        try:
            opened = load_file(self.path)
        except SessionError as error:
            raise EngineError(str(error)) from None
        if problem := is_another(self.session, opened.session):
            raise EngineError(f"{self.path}: {problem}")
        session, left = kept(self.session, opened.session)
        if problems := validate(session):  # the old and the new parts may contradict each other
            raise EngineError("; ".join([*left, *map(str, problems)]))
        return opened, session, left


class FileCommands(EnginePart):
    """Executes them, on the I/O thread; files are read on others."""

    def __init__(self, bridge: Bridge, file: EngineFile, access: Access) -> None:
        self._bridge = bridge
        self._file = file
        self._access = access
        self.handlers = {
            AddClient: self.add_client,
            ChangeClient: self.change_client,
            Reload: self.reload,
            RemoveClient: self.remove_client,
            Save: self.save,
        }

    # --- clients

    async def add_client(self, command: AddClient) -> None:
        client, keys = command.client, await self._keys_of(command.client)
        await self._bridge.change_clients(with_client(self._bridge.session, client), {client.name: keys})
        await self._client_saved(client.name)

    async def change_client(self, command: ChangeClient) -> None:
        client, keys = command.client, await self._keys_of(command.client)
        session = self._bridge.session
        # The topics that are proposed to the client stay.
        client = msgspec.structs.replace(client, topics=client_named(session, client.name).topics)
        await self._bridge.change_clients(with_changed_client(session, client), {client.name: keys})
        await self._client_saved(client.name)

    async def remove_client(self, command: RemoveClient) -> None:
        await self._bridge.change_clients(without_client(self._bridge.session, command.name), {})
        await self._client_saved(command.name)

    async def _keys_of(self, client: Client) -> tuple[Key, ...]:
        """Return the keys that are in a client's key files now.

        Raises:
            EngineError: there is none, or an operator has one of them.
        """
        session = self._file.session
        if session.role != "server":
            raise EngineError(Unable.NOT_A_SERVER())
        # Others' key files may have changed, or be gone: that is for a reload to find.
        alone = msgspec.structs.replace(session, clients=(client,), operators=())
        keys, _ = await _read(lambda: load_keys(alone, self._file.folder()))
        self._access.check_link(keys)
        self._access.warn_of(keys, {})
        return keys[client.name]

    async def _client_saved(self, name: str) -> None:
        """Take over a client's entry from the file: a change of a client is written there first."""
        file = self._file
        path, before, held = file.path, file.opened, file.contents.session
        if path is None or before is None or held is None:
            return
        now = await _read(lambda: open_file(path))
        # Another change of the file is somebody else's, which a save must not overwrite.
        if now is not None and same(_without(before.session, name), _without(now.session, name)):
            file.opened = now
            file.contents.session = held.with_clients(now.session.accepted_clients)

    # --- the session

    async def reload(self, command: Reload) -> Reloaded:
        file, access, events = self._file, self._access, self._bridge.context.events
        dry_run, drop_arm, who = command.dry_run, command.drop_arm, operator()
        try:
            # All files are read before anything changes, and no link waits for the disk.
            opened, session, left = await _read(file.read_again)
            path = opened.path
            places = await _read(lambda: demand_places(path))
            keys, granted = await _read(lambda: load_keys(session, path.parent))
        except EngineError as error:
            if not dry_run:
                text = f"not reloaded, nothing is changed: {str(error).replace(chr(10), '; ')}"
                events.add(Level.ERROR, EventCode.ENGINE_RELOAD_FAILED, text, who=who)
            raise
        if command.seen:
            would, _ = await self._bridge.reload(session, keys, dry_run=True, drop_arm=drop_arm)
            if command.seen != _digest([*would, *access.reload(granted, dry_run=True)]):
                raise EngineError(Unable.RELOADS_OTHER())
        if dry_run:
            done, failed = await self._bridge.reload(session, keys, dry_run=True, drop_arm=drop_arm)
            done += access.reload(granted, dry_run=True)
            return Reloaded(tuple(done), tuple(left), tuple(failed), _digest(done))
        access.warn_of(keys, granted)
        file.contents.session = session  # now, since what fails names the lines of this file
        done, failed = await self._bridge.reload(session, keys, dry_run=False, drop_arm=drop_arm)
        file.places = places
        self._bridge.context.demands.set_places(places)
        done += access.reload(granted, dry_run=False)
        file.session, file.base, file.opened = session, path.parent, opened
        if not (done or failed or left):
            text = f"reload by {who}: nothing differs in {path}"
            events.add(Level.INFO, EventCode.OPERATOR_RELOADED, text, who=who)
        for text in left:
            events.add(Level.WARNING, EventCode.ENGINE_RELOAD_INCOMPLETE, f"reload by {who}: {text}", who=who)
        return Reloaded(tuple(done), tuple(left), tuple(failed), _digest(done))

    async def save(self, _: Save) -> None:
        file, session = self._file, self._bridge.session
        path, known = file.path, file.opened
        if path is None:
            raise EngineError(Unable.NO_FILE())
        if path.parent.resolve() != file.base.resolve():
            raise EngineError(Unable.SAVED_ELSEWHERE())
        try:
            file.opened = await _read(lambda: _saved(session, path, known))
        except SessionError as error:
            raise EngineError(str(error)) from None
        file.contents.session = session
        file.places = await _read(lambda: demand_places(path))
        self._bridge.context.demands.set_places(file.places)
        who = operator()
        text = f"saved to {path.name} by {who}"
        self._bridge.context.events.add(Level.INFO, EventCode.OPERATOR_SAVED, text, who=who)


def _without(session: Session, client: str) -> Session:
    others = tuple(each for each in session.accepted_clients if each.name != client)
    return session.with_clients(others)


def _saved(session: Session, path: Path, known: SessionFile | None) -> SessionFile:
    """Write a session to its file, unless the file on disk holds it already, and return the file.

    Raises:
        SessionError: it is not written: somebody else has changed the file, say.
    """
    now = open_file(path)
    if now is not None and same(now.session, session):
        return now
    if known is None:
        known = load_file(path)  # its mistakes are the reason why it is not overwritten
    return save(session, path, known)


def _digest(changes: list[str]) -> str:
    return hashlib.sha256("\n".join(changes).encode()).hexdigest()[:16] if changes else ""
