"""The files in which a bridge keeps its events and its time line, and its claim to them."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from typing import TYPE_CHECKING

from rsb_bridge.config.files import owner_only
from rsb_bridge.config.state_folder import searched_folders
from rsb_bridge.feature_api import file_stem, make_folder

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

EVENTS, HISTORY, _LOCK = ".jsonl", ".history", ".lock"
_BRIDGES_OF_A_NAME = 9
"""A round figure: the tenth one is refused, and commands look for files under each number."""
_ROLE_LENGTH = 20
"""Bytes that are read of a lock's file: no role is as long."""


class Files:
    """The files of one bridge. If several bridges have one name, the second one's files are ``NAME-2`` and so on.

    Args:
        folder: of the files; it may be missing.
        stem: their name without suffix.
    """

    def __init__(self, folder: Path, stem: str) -> None:
        self.folder = folder
        self.stem = stem

    @property
    def events(self) -> Path:
        """The newest file of events."""
        return self.folder / f"{self.stem}{EVENTS}"

    @property
    def history(self) -> Path:
        """The file of the time line."""
        return self.folder / f"{self.stem}{HISTORY}"


class Claim:
    """The files of one bridge that no other process has, until `close`.

    Both sides of a link may run on one machine under one name: a file that belongs to a session of the other role is
    left to it.

    Args:
        folder: made if it is missing, mode 0700.

    Raises:
        OSError: the folder cannot be written to.
    """

    def __init__(self, folder: Path, name: str, role: str) -> None:
        make_folder(folder, 0o700)
        for stem in _stems(name):
            # A file of its own: the others are replaced by renames, and a lock would stay with the old one.
            lock = owner_only(str(folder / f"{stem}{_LOCK}"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
            try:
                if _take(lock, role):
                    self._lock = lock
                    self.files = Files(folder, stem)
                    return
            except BaseException:
                os.close(lock)
                raise
            os.close(lock)
        raise OSError(
            errno.EBUSY, f"{_BRIDGES_OF_A_NAME} other bridges named {name} keep their files here", str(folder)
        )

    def close(self) -> None:
        """Release the files for another process."""
        # The lock's file stays: it says for which role the others are.
        os.close(self._lock)


def _take(lock: int, role: str) -> bool:
    """Lock a file, if it is of this role or nobody's."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    owner = os.read(lock, _ROLE_LENGTH).decode(errors="replace").strip()
    if not owner:
        os.pwrite(lock, role.encode(), 0)
    return owner in ("", role)


def claimed_roles(folder: Path, name: str) -> dict[str, str]:
    """Return the stems that bridges of a session's name have claimed in a folder, with their roles as far as known."""
    roles = {}
    for stem in _stems(name):
        try:
            roles[stem] = (folder / f"{stem}{_LOCK}").read_text(errors="replace").strip()
        except FileNotFoundError:
            continue
        except OSError:
            roles[stem] = ""
    return roles


def _stems(name: str) -> list[str]:
    return [file_stem(name, number) for number in range(1, _BRIDGES_OF_A_NAME + 1)]


def files_of(name: str, environ: Mapping[str, str]) -> list[Files]:
    """Return the places where bridges of a session's name have kept files that this user may read."""
    return [Files(folder, stem) for folder in searched_folders(environ) for stem in _stems(name)]


def kept_bridges(environ: Mapping[str, str]) -> list[Files]:
    """Return all bridges that have left files which this user may read."""
    found: list[Files] = []
    for folder in searched_folders(environ):
        with contextlib.suppress(OSError):
            stems = {path.name.removesuffix(HISTORY) for path in folder.iterdir() if path.suffix == HISTORY}
            found += [Files(folder, stem) for stem in sorted(stems)]
    return found
