"""Paths as people type them, and atomic writing."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path


def typed_path(text: str) -> Path:
    """A path that a person typed: ``~`` is a home directory, if there is one."""
    try:
        return Path(text).expanduser()
    except RuntimeError:  # no such user
        return Path(text)


def kind_of_file(mode: int) -> str:
    """The kind of a file in words, from its `os.stat_result.st_mode`."""
    kinds = {
        stat.S_IFREG: "a file",
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a FIFO",
        stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
    }
    return kinds[stat.S_IFMT(mode)]


def replace_file(path: Path, content: bytes, *, like: Path | None = None) -> None:
    """Replace a file atomically. If that fails, the old file stays as it was.

    Args:
        path: of the file, which need not exist. A symbolic link is followed, and stays one.
        content: the whole file.
        like: a file whose mode, owner and group the new one gets. None: the mode is 0600, owner and group are those of
            the file that is replaced. Both are as far as this user may give them.

    Raises:
        OSError: the file cannot be written, or the path leads to something else (a device, a FIFO, a folder).
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, f"is {kind_of_file(target.stat().st_mode)}, not a file", str(path))
    model = like if like is not None else target
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)  # mkstemp's mode is 0600
    try:
        with os.fdopen(handle, "wb") as file:
            if model.exists():
                give_owner(handle, model)
                if like is not None:
                    os.fchmod(handle, stat.S_IMODE(model.stat().st_mode))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(name).unlink()
        raise
    _sync_folder(target.parent)


def give_owner(file: int | Path, like: Path) -> None:
    """Give a file the owner and the group of another; where only the group may be given, that.

    Args:
        file: its path or descriptor.
        like: the other one.
    """
    model = like.stat()
    for owner in (model.st_uid, -1):
        with suppress(OSError):  # not permitted, or a user that there is not in this container
            os.chown(file, owner, model.st_gid)
            return


def _sync_folder(folder: Path) -> None:
    """Make a rename in a folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
