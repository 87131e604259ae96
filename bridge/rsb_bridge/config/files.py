"""Paths as people write them, and files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path


def typed_path(text: str) -> Path:
    """A path that a person wrote: ``~`` is a home, where there is such a home."""
    try:
        return Path(text).expanduser()
    except RuntimeError:  # nobody here is called so
        return Path(text)


def kind_of_file(mode: int) -> str:
    """What a file is, in words, of its `os.stat_result.st_mode`."""
    kinds = {
        stat.S_IFREG: "a file",
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a FIFO",
        stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
    }
    return kinds[stat.S_IFMT(mode)]


def replace_file(path: Path, content: bytes) -> None:
    """Write a file in place of what was there, mode 0600. If it fails, what was there still is.

    Args:
        path: of a file, or of nothing yet. A symbolic link is followed, so that it stays one.
        content: the whole file.

    Raises:
        OSError: it could not be written, or what is there is no file (a device, a FIFO, a folder): that is left alone.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, f"is {kind_of_file(target.stat().st_mode)}, not a file", str(path))
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)  # mkstemp's mode is 0600
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(name).unlink()
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last through a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
