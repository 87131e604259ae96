"""A user who is not root, with a folder, and a process of that user's; only root can have them."""

from __future__ import annotations

import os
import signal
import stat
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

OTHER = 65534
"""The uid of a user who owns nothing here, and the gid."""
only_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user, too")


@contextmanager
def folder_for_all() -> Iterator[Path]:
    """A new folder of root's that every user can enter: pytest's own folders are closed."""
    with tempfile.TemporaryDirectory(prefix="rsb-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder


def theirs(path: Path) -> Path:
    """Give a file or a folder to the other user."""
    os.chown(path, OTHER, OTHER, follow_symlinks=False)
    return path


@contextmanager
def process_of_other(work: Callable[[], None]) -> Iterator[int]:
    """A process of the other user's, which does something until the end of this context. Yields its pid."""
    pid = os.fork()
    if pid == 0:
        try:
            os.setgroups([])
            os.setresgid(OTHER, OTHER, OTHER)
            os.setresuid(OTHER, OTHER, OTHER)
            work()
        finally:
            os._exit(0)
    try:
        yield pid
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def files_in(folder: Path) -> dict[str, tuple[int, int, int, bytes]]:
    """Return owner, group, mode and content of a folder and all that is in it."""
    found = {}
    for path in (folder, *folder.rglob("*")):
        status = path.lstat()
        content = path.read_bytes() if stat.S_ISREG(status.st_mode) else b""
        found[str(path)] = status.st_uid, status.st_gid, status.st_mode, content
    return found
