"""Paths and names of files, atomic writing, and the reasons why a file cannot be written, in plain words."""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, TextIO

from rsb_bridge.config.folder_owner import acting_in_folder, folder_owner
from rsb_bridge.model.text import several_lines
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator


SHORTAGES: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG})
"""Errors about space or quota rather than about a path or rights."""


class Shortage(Wording):
    """Lacks that keep a file from being written, and their remedies."""

    DISK_FULL = "{error}: the disk is full; free space on {mount} (df -h {mount})"
    NO_INODES = "{error}: the disk has no room for more files (df -i); free space on {mount} (df -h {mount})"
    QUOTA = "{error}: this user's quota on {mount} is used up (quota -s); remove some of your files there"
    READ_ONLY = "{error}: {mount} is read-only; if that is unexpected, its disk has failed (see dmesg)"
    FILE_SIZE = "{error}: the file is too large for this process; raise ulimit -f or LimitFSIZE"


class FileRefused(Wording):
    NOT_A_FILE = "is {kind}, not a file"
    OF_ANOTHER = "is another user's file, who could read what root writes: remove it, or name another file"


class FileRisk(Wording):
    """Reasons why another user can change a file, and the remedies."""

    OTHER_OWNER = "{path} belongs to another user (uid {uid}), or is in a folder of that user's"
    WRITABLE = "others may write to {path}: run `chmod o-w {path}`"
    REPLACEABLE = "others can replace {path}: run `chmod o-w {folder}`"


_STEM_LENGTH = 64  # characters; a file's name has at most 255 bytes, and a suffix and a number come behind it


def file_stem(name: str, number: int = 1) -> str:
    """Return a session's name as a file's name without suffix; the number tells sessions of one name apart."""
    # No dot first: the file would be hidden.
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:_STEM_LENGTH].lstrip(".") or "_"
    return safe if number == 1 else f"{safe}-{number}"


def typed_path(text: str) -> Path:
    """Return the path that a person typed; ``~`` becomes the home directory, if there is one."""
    try:
        return Path(text).expanduser()
    except RuntimeError:  # no such user
        return Path(text)


def stat_of(path: Path) -> os.stat_result | None:
    """Return what the kernel says of a path, or None if nothing is there.

    Raises:
        OSError: nobody can tell: a folder on the way is closed to this user, or a name is too long. `Path.exists`
            raises this up to Python 3.13, and answers False from 3.14 on.
    """
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a NUL in the name
        return None


def is_there(path: Path) -> bool:
    """Whether this user can see anything at a path. Where that is False, reading or writing gives the reason."""
    try:
        return stat_of(path) is not None
    except OSError:
        return False


def change_by_others(path: Path) -> str:
    """Return the reason why a user other than this one and root can change a file, or an empty string.

    Raises:
        OSError: the file cannot be looked at.
    """
    status, folder = path.stat(), Path(os.path.realpath(path)).parent
    of_folder = folder.stat()
    owners = {status.st_uid, of_folder.st_uid, folder_owner(path) or 0} - {0, os.geteuid()}
    if owners:
        return FileRisk.OTHER_OWNER(path=path, uid=min(owners))
    if status.st_mode & stat.S_IWOTH:
        return FileRisk.WRITABLE(path=path)
    # With the sticky bit, as of /tmp, nobody can replace another user's file.
    if of_folder.st_mode & stat.S_IWOTH and not of_folder.st_mode & stat.S_ISVTX:
        return FileRisk.REPLACEABLE(path=path, folder=folder)
    return ""


def kind_of_file(mode: int) -> str:
    """Return the kind of a file in words, from its `os.stat_result.st_mode`."""
    kinds = {
        stat.S_IFREG: "a file",
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a FIFO",
        stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
    }
    return kinds[stat.S_IFMT(mode)]


def replace_file(
    path: Path, content: bytes, *, like: Path | None = None, mode: int = 0o600, owner: Path | None = None
) -> None:
    """Replace a file atomically. If that fails, the old file stays as it was.

    In another user's folder, root does it with that user's rights.

    Args:
        path: of the file. It may be new. A symbolic link is followed, and stays one.
        like: a file whose mode, owner and group the new one gets. Without it, the owner and group of the replaced file
            stay. Both as far as this user may give them.
        mode: of the file, without `like`.
        owner: a file whose owner and group one gets that replaces nothing.

    Raises:
        OSError: the file cannot be written, or the path leads to something else (a device, a FIFO, a folder), or it is
            a symbolic link of another user, which could lead to any file of this one.
    """
    with acting_in_folder(path):
        _replace_file(path, content, like, mode, owner)


def _replace_file(path: Path, content: bytes, like: Path | None, mode: int, owner: Path | None) -> None:
    # The kernel's own check (proc_sys_fs(5), protected_symlinks) misses files that are put in place by a rename.
    if path.is_symlink() and path.lstat().st_uid not in (0, os.geteuid()):
        raise OSError(errno.EPERM, "is a symbolic link of another user", str(path))
    target = Path(os.path.realpath(path))
    old = stat_of(target)
    if old is not None and not stat.S_ISREG(old.st_mode):
        raise OSError(errno.EINVAL, FileRefused.NOT_A_FILE(kind=kind_of_file(old.st_mode)), str(path))
    if old is not None and old.st_uid not in (0, os.geteuid()) and _is_for_all(target.parent):
        raise OSError(errno.EPERM, FileRefused.OF_ANOTHER(), str(path))
    model = like if like is not None else owner if old is None else None
    # In the target's folder, because a rename does not cross file systems.
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)  # mkstemp's mode is 0600
    try:
        with os.fdopen(handle, "wb") as file:
            found = old if model is None else stat_of(model)
            # The owner first: with the mode first, this user's group could open the file for a moment.
            if found is not None:
                _give_owner(handle, found)
            os.fchmod(handle, mode if like is None or found is None else stat.S_IMODE(found.st_mode))
            file.write(content)
            file.flush()
            # Before the rename: after a power cut, the new name must not lead to a file without contents.
            os.fsync(file.fileno())
        Path(name).replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(name).unlink()
        raise
    sync_folder(target.parent)


def sync_folder(folder: Path) -> None:
    """Have the names of new and renamed files survive a power cut; raises OSError."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _is_for_all(folder: Path) -> bool:
    """Whether every user may create files there, as in /tmp, where only root can replace other users' files."""
    return bool(folder.stat().st_mode & stat.S_IWOTH)


def write_whole(path: Path, text: str) -> None:
    """Write a text to a path: a file atomically, a device or a pipe directly.

    The file has mode 0600, also where it replaces one that others could read. Control characters in the text are
    escaped.

    Raises:
        OSError: it cannot be written; an old file is as it was.
    """
    clean = several_lines(text)
    old = stat_of(path)
    if old is None:
        with new_file(path) as file:
            file.write(clean)
    elif stat.S_ISREG(old.st_mode):
        replace_file(path, clean.encode())
    else:
        with acting_in_folder(path):
            path.write_text(clean, encoding="utf-8")


@contextmanager
def new_file(path: Path, newline: str | None = None, *, owner: Path | None = None) -> Iterator[TextIO]:
    """A text file that is not there yet, mode 0600; where writing it fails, it is not there either.

    Args:
        owner: a file whose owner and group it gets.

    Raises:
        OSError: it is there, or it cannot be written.
    """
    handle = owner_only(str(path), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline=newline) as file:
            if owner is not None and (model := stat_of(owner)) is not None:
                _give_owner(handle, model)  # by its descriptor: its name may lead elsewhere by now
            yield file
    except BaseException:  # of the caller, too: half a file would refuse the next try
        remove_file(path)
        raise


UNFINISHED: Final = ".part"
"""The end of the name that a file has until it is whole; it begins with a dot."""


@contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A file that is not there yet, mode 0600, and gets its name once it is whole; where writing it fails, it is gone.

    If this process is killed meanwhile, a part stays that no program takes for the file.

    Raises:
        OSError: it is there or being written, or it cannot be written.
    """
    part = path.with_name(f".{path.name}{UNFINISHED}")
    handle = owner_only(str(part), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
    try:
        with os.fdopen(handle, "wb") as file:
            # Not before: as long as the part is there, no other process gives a file this name.
            if is_there(path):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
            yield file
            file.flush()
            os.fsync(handle)  # else the name may outlive a loss of power, and the content not
        with acting_in_folder(path):
            part.rename(path)
    except BaseException:  # of the caller, too: half a file is of no use
        remove_file(part)
        raise


def remove_file(path: Path) -> None:
    """Remove a file, if it is there.

    Raises:
        OSError: it cannot be removed.
    """
    with acting_in_folder(path):
        path.unlink(missing_ok=True)


def make_folder(path: Path, mode: int = 0o777) -> None:
    """Make a folder and those on the way to it, as far as they are missing; `mode` is the last one's.

    Raises:
        OSError: it cannot be made.
    """
    with acting_in_folder(path):
        path.mkdir(mode, parents=True, exist_ok=True)


def owner_only(path: str, flags: int) -> int:
    """Open a file that is no symbolic link, with mode 0600 from the start: an opener for `open`."""
    with acting_in_folder(Path(path)):
        handle = os.open(path, flags | os.O_NOFOLLOW, 0o600)
        try:
            os.fchmod(handle, 0o600)  # the umask may leave less, and an earlier file may be open to others
        except BaseException:
            os.close(handle)
            raise
    return handle


def _give_owner(handle: int, model: os.stat_result) -> None:
    """Give an open file the owner and the group of another; where only the group may be given, that."""
    for owner in (model.st_uid, -1):
        with suppress(OSError):  # not permitted, or a user that there is not in this container
            os.fchown(handle, owner, model.st_gid)
            return


def why_not_written(error: OSError, path: Path) -> str:
    """Return the reason why a file cannot be written.

    Args:
        path: path of the file or of its folder.
    """
    reason = error.strerror or str(error)
    if error.errno not in SHORTAGES:
        return reason
    mount = Path(os.path.realpath(path))  # at which its file system is mounted
    while not (mount.exists() and mount.is_mount()) and mount != mount.parent:
        mount = mount.parent
    match error.errno:
        case errno.ENOSPC:
            with suppress(OSError):
                found = os.statvfs(mount)
                if found.f_files and not found.f_favail:  # btrfs has no fixed number of files, and says 0
                    return Shortage.NO_INODES(error=reason, mount=mount)
            return Shortage.DISK_FULL(error=reason, mount=mount)
        case errno.EDQUOT:
            return Shortage.QUOTA(error=reason, mount=mount)
        case errno.EROFS:
            return Shortage.READ_ONLY(error=reason, mount=mount)
        case _:
            return Shortage.FILE_SIZE(error=reason)
