"""Root's files in the folders of other users: opened with that user's rights, so that no link there misleads root."""

from __future__ import annotations

import errno
import os
import stat
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST_LINKS: Final = 40  # that the kernel follows on the way to a file (path_resolution(7))
_SETGROUPS: Final = {"x86_64": 116, "aarch64": 159, "riscv64": 159, "armv7l": 206, "i686": 206}
"""Number of the system call, by machine: the C library's function is for all threads of the process."""
_UNCHANGED: Final = -1


class NotActing(Wording):
    """The reason why root does not write into another user's folder."""

    NO_RIGHT = "belongs to uid {uid}, as whom this process may not act: run it as that user"


class _Acting(threading.local):
    """Whether this thread has another user's rights already."""

    now = False


_acting = _Acting()


def folder_owner(path: Path) -> int | None:
    """Return the first user other than root who owns a folder or a link on the way to a file, or None.

    From there on, that user decides where the path leads. Nobody decides it for a process that is not root's: such a
    process can do no more than its user, and `folder_owner` is None for it.
    """
    if os.geteuid():
        return None
    waiting, at, links = [*reversed(path.absolute().parts)], Path("/"), 0
    while waiting:
        part = waiting.pop()
        if part in ("/", ".."):
            at = Path("/") if part == "/" else at.parent
            continue
        try:
            status = (at / part).lstat()
        except OSError:  # what opens the path gives the reason
            return None
        is_link = stat.S_ISLNK(status.st_mode)
        if status.st_uid and (waiting or is_link):
            return status.st_uid
        if is_link and links < _MOST_LINKS:
            links += 1
            waiting += reversed((at / part).readlink().parts)
        else:
            at /= part
    return None


@contextmanager
def acting_in_folder(path: Path) -> Iterator[None]:
    """Have this thread open, make, replace and remove a file with the rights of the user who owns its folder.

    Only root has to. New files belong to that user. Other threads keep their rights; none may be started meanwhile, as
    it would begin with these.

    Raises:
        OSError: this process may not act as that user.
    """
    with acting_as(folder_owner(path), path):
        yield


@contextmanager
def acting_as(uid: int | None, path: Path) -> Iterator[None]:
    """Have this thread use files with a user's rights only; None leaves its own.

    Where it has another user's rights already, it keeps these: a path that one user names must not bring it those of
    a third one.

    Raises:
        OSError: this process may not act as that user; `path` is named as the reason.
    """
    if not uid or os.geteuid() or _acting.now:
        yield
        return
    (own_group, own_groups), (group, groups) = (os.getegid(), os.getgroups()), _groups_of(uid, path)
    _acting.now = True
    try:
        if not _become(uid, group, groups):
            raise OSError(errno.EPERM, NotActing.NO_RIGHT(uid=uid), str(path))
        yield
    finally:
        _become(0, own_group, own_groups)
        _acting.now = False


def _groups_of(uid: int, path: Path) -> tuple[int, list[int]]:
    """Return a user's own group, and all groups."""
    import pwd  # noqa: PLC0415 -- only root needs it, and seldom, here and below

    try:
        user = pwd.getpwuid(uid)
    except KeyError:  # as in a container: then a folder of that user's knows the group
        group = next((s.st_gid for each in path.absolute().parents if (s := _status(each)) and s.st_uid == uid), uid)
        return group, []
    return user.pw_gid, os.getgrouplist(user.pw_name, user.pw_gid)


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except OSError:
        return None


def _become(uid: int, group: int, groups: list[int]) -> bool:
    """Give this thread alone a user's rights to files; return whether it has them."""
    import ctypes  # noqa: PLC0415
    import platform  # noqa: PLC0415

    # With `os.seteuid`, every thread would have them: one that decides who may attach would let that user in.
    libc, number = ctypes.CDLL(None), _SETGROUPS.get(platform.machine())
    given = (ctypes.c_uint32 * len(groups))(*groups)
    has_groups = number is not None and libc.syscall(ctypes.c_long(number), ctypes.c_long(len(groups)), given) == 0
    libc.setfsgid(ctypes.c_int(group))
    if has_groups or not uid:
        libc.setfsuid(ctypes.c_int(uid))
    # Neither call reports a failure; both return what was there before.
    has_ids = libc.setfsgid(ctypes.c_int(_UNCHANGED)) == group and libc.setfsuid(ctypes.c_int(_UNCHANGED)) == uid
    return has_groups and has_ids
