"""Session files written from the console: what is not saved yet, where key files are from there, overwriting asks."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.files import typed_path
from rsb_bridge.session_file import SessionError, load, save

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.session import Session, Topic
    from rsb_console.app import ConsoleApp


def unsaved(saved: Session, now: Session) -> str:
    """How the topics differ from those in the file, in words; empty: they don't."""
    before, after = _by_route(saved), _by_route(now)
    kinds = {
        "added": [route for route in after if route not in before],
        "removed": [route for route in before if route not in after],
        "changed": [route for route in after if route in before and after[route] != before[route]],
    }
    return "; ".join(f"{kind} {', '.join(topic for topic, _ in routes)}" for kind, routes in kinds.items() if routes)


def _by_route(session: Session) -> dict[tuple[str, str], Topic]:
    return {(topic.topic, topic.direction): topic for topic in session.topics}


def moved(session: Session, old: Path, new: Path) -> Session:
    """A session whose file moves to another folder: its key files are named as from there.

    Args:
        session: names its key files relative to `old`.
        old: a folder.
        new: the folder of its new file.
    """
    if old.resolve() == new.resolve():
        return session

    def rename(key_file: str | None) -> str | None:
        if key_file is None or typed_path(key_file).is_absolute():
            return key_file
        return os.path.relpath((old / key_file).resolve(), new.resolve())

    clients = tuple(msgspec.structs.replace(each, key_file=rename(each.key_file)) for each in session.clients)
    return msgspec.structs.replace(session, key_file=rename(session.key_file), clients=clients)


def path_problem(text: str) -> str:
    """Why a session cannot be written to a path that was typed; empty: it can, as far as one sees."""
    path = typed_path(text)
    if not text:
        return "missing: name the file"
    try:
        if path.is_dir():
            return "is a folder: name a file in it"
        return "" if path.parent.is_dir() else f"there is no folder {path.parent}"
    except OSError as error:  # its name is too long, or a folder on the way is not ours to look into
        return f"cannot be written: {error.strerror}"


def topics_note(session: Session) -> str:
    """What a saved session does not hold, though the console shows it; empty: it holds all."""
    if session.role == "client":
        return ""
    return "\nIt holds no topics: they are in the clients' files; those added here last until this server ends."


def holds(path: Path, session: Session) -> bool:
    """Whether a file says just this session already; False where it is no session file."""
    try:
        return load(path) == session
    except SessionError:
        return False


async def save_asking(app: ConsoleApp, session: Session, path: Path, *, note: str = "") -> bool:
    """Write a session file; ask before one is overwritten, and tell the operator how it went.

    Args:
        app: asks and tells.
        session: with its key files named as from `path`.
        path: of the file. One that says the same already is left alone, with its comments.
        note: what to tell besides.

    Returns:
        Whether the file holds the session now.
    """
    from rsb_console.screens.confirm import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

    if holds(path, session):
        app.notify(f"nothing has changed: {path} is as it would be saved{note}", markup=False, timeout=8 if note else 3)
        return True
    if path.exists():  # noqa: ASYNC240 -- one stat
        words = "What is in the file now is replaced, comments too."
        if not await app.push_screen_wait(ConfirmScreen(f"Overwrite {path.name}?", words, "Overwrite")):
            return False
    try:
        save(session, path)
    except SessionError as error:
        app.notify(str(error), title="Not saved", severity="error", markup=False, timeout=15)
        return False
    app.notify(f"saved: {path}{note}", markup=False, timeout=8 if note else 3)
    return True
