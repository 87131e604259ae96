"""What keeps a file from being written, in plain words: which file system, what it lacks, and the remedy."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Final

from rsb_bridge.model.wording import Wording

SHORTAGES: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG})
"""The errors that are no mistake of a path or of rights: there is no room, or none for this user."""


class Shortage(Wording):
    """Lacks that keep a file from being written, and their remedies."""

    DISK_FULL = "{error}: the disk is full; free space on {mount} (df -h {mount})"
    NO_INODES = "{error}: the disk has no room for more files (df -i); free space on {mount} (df -h {mount})"
    QUOTA = "{error}: this user may have no more on {mount} (quota -s); remove files of yours there"
    READ_ONLY = "{error}: {mount} may only be read; if nobody meant that, its disk has failed (dmesg)"
    FILE_SIZE = "{error}: this process may write no larger files (ulimit -f, LimitFSIZE)"


def why_not_written(error: OSError, path: Path) -> str:
    """Why a file cannot be written.

    Args:
        error: what writing it raised.
        path: of the file; a folder will do.
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
    """The folder at which the file system of a path is mounted."""
    folder = Path(os.path.realpath(path))
    while not (folder.exists() and folder.is_mount()) and folder != folder.parent:
        folder = folder.parent
    return folder


def _has_inodes(mount: Path) -> bool:
    try:
        found = os.statvfs(mount)
    except OSError:
        return True
    return found.f_files == 0 or found.f_favail > 0
