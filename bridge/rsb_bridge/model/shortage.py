"""Reasons why a file cannot be written, in plain words: the file system, the lack and the remedy."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Final

from rsb_bridge.model.wording import Wording

SHORTAGES: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG})
"""Errors about space or quota rather than about a path or rights."""


class Shortage(Wording):
    """Lacks that keep a file from being written, and their remedies."""

    DISK_FULL = "{error}: the disk is full; free space on {mount} (df -h {mount})"
    NO_INODES = "{error}: the disk has no room for more files (df -i); free space on {mount} (df -h {mount})"
    QUOTA = "{error}: this user's quota on {mount} is used up (quota -s); remove some of your files there"
    READ_ONLY = "{error}: {mount} is read-only; if that is unexpected, its disk has failed (see dmesg)"
    FILE_SIZE = "{error}: the file is too large for this process; raise ulimit -f or LimitFSIZE"


def why_not_written(error: OSError, path: Path) -> str:
    """Return the reason why a file cannot be written.

    Args:
        path: path of the file or of its folder.
    """
    reason = error.strerror or str(error)
    if error.errno not in SHORTAGES:
        return reason
    mount = _mount_of(path)
    match error.errno:
        case errno.ENOSPC:
            return (Shortage.DISK_FULL if _has_inodes(mount) else Shortage.NO_INODES)(error=reason, mount=mount)
        case errno.EDQUOT:
            return Shortage.QUOTA(error=reason, mount=mount)
        case errno.EROFS:
            return Shortage.READ_ONLY(error=reason, mount=mount)
        case _:
            return Shortage.FILE_SIZE(error=reason)


def _mount_of(path: Path) -> Path:
    """Return the folder at which the file system of a path is mounted."""
    folder = Path(os.path.realpath(path))
    while not (folder.exists() and folder.is_mount()) and folder != folder.parent:
        folder = folder.parent
    return folder


def _has_inodes(mount: Path) -> bool:
    try:
        found = os.statvfs(mount)
    except OSError:
        return True
    return found.f_files == 0 or found.f_favail > 0  # btrfs has no fixed number of files, and says 0
