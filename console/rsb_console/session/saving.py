"""Saving a session: the unsaved changes, and the paths of its key files from another folder."""

from __future__ import annotations

import difflib
import os
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from rsb_bridge.config.files import is_there, typed_path
from rsb_bridge.config.keys import Key, KeyFileError, key_path, read_key
from rsb_bridge.config.session_file import SessionError, SessionFile, open_file, same
from rsb_bridge.config.yaml_text import read_text
from rsb_bridge.model.session import session_keys
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.model.session import Client, Session

    _Entry = TypeVar("_Entry", Session, Client)


class PathProblem(Wording):
    """Reasons why a session cannot be written to a path."""

    NO_FOLDER = "there is no folder {folder}"


def unsaved(saved: Session, now: Session) -> str:
    """Describe the differences between the session and its file; empty if there are no differences."""
    before, after = _parts(saved), _parts(now)
    kinds = {
        "added": [part for part in after if part not in before],
        "removed": [part for part in before if part not in after],
        "changed": [part for part in after if part in before and after[part] != before[part]],
    }
    return "; ".join(f"{kind} {', '.join(part[0] for part in parts)}" for kind, parts in kinds.items() if parts)


def _parts(session: Session) -> dict[tuple[str, ...], object]:
    """Return the comparable parts of a session, each by its name for people and further identification."""
    others = (name for name in session.__struct_fields__ if name not in ("topics", "clients", "features"))
    parts: dict[tuple[str, ...], object] = {(name,): getattr(session, name) for name in others}
    parts |= {(name,): key.of(session) for name, key in session_keys().items()}
    parts |= {(topic.topic, *topic.identity): topic for topic in session.topics}
    for client in session.accepted_clients if session.role == "server" else ():
        # The client's topics are parts of their own.
        parts[f"client {client.name}",] = msgspec.structs.replace(client, topics=())
        parts |= {(f"{topic.topic} for {client.name}", *topic.identity): topic for topic in client.topics}
    return parts


def difference(before: str, after: str) -> list[str]:
    """Return the lines of a unified diff of two texts, without file names."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=2)
    return list(lines)[2:]


def text_of(path: Path) -> str:
    """Return the text of a file, or an empty string if it is not text."""
    try:
        return read_text(path)
    except SessionError:
        return ""


def is_changed(opened: SessionFile) -> bool:
    """Whether somebody else has changed a file on disk since it was opened."""
    try:
        opened.check_unchanged()
    except SessionError:
        return True
    return False


def moved(session: Session, old: Path, new: Path) -> Session:
    """Make a session's key files relative to another folder.

    Args:
        session: session whose key files are relative to `old`.
        new: the folder of its new file.
    """
    if old.resolve() == new.resolve():
        return session

    return _renamed(session, lambda key_file: os.path.relpath((old / key_file).resolve(), new.resolve()))


def rescued(session: Session, old: Path, new: Path) -> tuple[Session, dict[Path, Key]]:
    """Do as `moved` for a folder that is deleted with the session: its keys move to the new file's folder.

    Args:
        session: session whose key files are relative to `old`.
        old: the folder that is deleted.
        new: the folder of its new file.

    Returns:
        The session, and the key files to write; none of them replaces another key.

    Raises:
        KeyFileError: a key cannot be read.
    """
    files: dict[Path, Key] = {}

    def rename(key_file: str) -> str:
        key = read_key(key_path(old, key_file))
        name = Path(key_file)
        places = (new / f"{name.stem}{number}{name.suffix}" for number in _numbers())
        path = next(each for each in places if files.get(each, key) == key and _is_free_for(key, each))
        if not is_there(path):
            files[path] = key
        return path.name

    return _renamed(session, rename), files


def _numbers() -> Iterator[str]:
    """Yield suffixes that make a file name unique: none, -2, -3 and so on."""
    yield ""
    yield from (f"-{number}" for number in count(2))


def _is_free_for(key: Key, path: Path) -> bool:
    """Whether there is no such file, or it holds this key."""
    try:
        # A symbolic link that leads nowhere is in the way, too, but does not exist for `exists`.
        return not os.path.lexists(path) or read_key(path) == key
    except KeyFileError:
        return False


def _renamed(session: Session, rename: Callable[[str], str]) -> Session:
    def name(key_file: str | None) -> str | None:
        return key_file if key_file is None or typed_path(key_file).is_absolute() else rename(key_file)

    def rename_in(entry: _Entry) -> _Entry:
        return msgspec.structs.replace(entry, key_file=name(entry.key_file), next_key_file=name(entry.next_key_file))

    clients = None if session.clients is None else tuple(map(rename_in, session.clients))
    return msgspec.structs.replace(rename_in(session), clients=clients)


def path_problem(text: str) -> str:
    """Return the reason why a session cannot be written to a typed path, or an empty string."""
    path = typed_path(text)
    if not text:
        return "missing: name the file"
    try:
        if path.is_dir():
            return "is a folder: name a file in it"
        return "" if path.parent.is_dir() else PathProblem.NO_FOLDER(folder=path.parent)
    except OSError as error:  # a name that is too long, or a folder without permission
        return f"cannot be written: {error.strerror}"


def file_of(path: Path, session: Session) -> SessionFile | None:
    """Return the file at a path if it holds exactly this session, or None."""
    file = open_file(path)
    return file if file is not None and same(file.session, session) else None
