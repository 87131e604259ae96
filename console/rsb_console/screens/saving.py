"""Saving a session from the console: asks before it overwrites a file, and tells how it went."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.keys import KeyFileError, copy_key
from rsb_bridge.config.session_file import SessionError, save
from rsb_console.screens.confirm import ConfirmScreen
from rsb_console.session.saving import file_of, moved, rescued, topics_note, unsaved

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.model.session import Session
    from rsb_console.console import Console


async def save_elsewhere(console: Console, session: Session, path: Path) -> bool:
    """Save the session that runs to a file that may lie in another folder.

    Args:
        console: runs the session. If that is temporary, its keys are copied beside the new file.
        session: the one that runs; its key files are relative to `console.base`.
        path: of the file.

    Returns:
        Whether the file holds the session and its key files are there.
    """
    note = topics_note(session)
    if not console.temporary:
        session = moved(session, console.base, path.parent)
        return await save_asking(console, session, path, note=note, opened=console.file)
    try:
        session, files = rescued(session, console.base, path.parent)
        if not await save_asking(console, session, path, note=note):
            return False
        for file, key in files.items():
            copy_key(key, file)
            console.notify(f"its key is saved, too: {file}", markup=False)
    except KeyFileError as error:
        console.notify(str(error), title="The key is not saved", severity="error", markup=False, timeout=15)
        return False
    return True


async def save_asking(
    console: Console, session: Session, path: Path, *, note: str = "", opened: SessionFile | None = None
) -> bool:
    """Write a session file; ask before one is changed or replaced, and tell the operator how it went.

    Args:
        console: asks and tells.
        session: its key files are relative to the folder of `path`.
        path: of the file; left alone if it holds the same session already.
        note: what else to tell.
        opened: the file that the session came from: its comments and layout are kept.

    Returns:
        Whether the file holds the session.
    """
    timeout = 8 if note else 3
    if file_of(path, session) is not None:
        message = f"nothing to save: {path} is up to date{note}"
        console.notify(message, markup=False, timeout=timeout)
        return True
    try:
        if path.exists():  # noqa: ASYNC240 -- one stat
            title, message, yes = f"Overwrite {path.name}?", "What is in the file now is replaced.", "Overwrite"
            if opened is not None and opened.is_at(path):
                opened.check_unchanged()
                message = f"Changes: {unsaved(opened.session, session)}. The rest of the file stays, comments too."
                title, yes = f"Save {path.name}?", "Save"
            if not await console.ask(ConfirmScreen(title, message, yes)):
                return False
        save(session, path, opened)
    except SessionError as error:
        console.notify(str(error), title="Not saved", severity="error", markup=False, timeout=15)
        return False
    console.notify(f"saved: {path}{note}", markup=False, timeout=timeout)
    return True
