"""The control sockets of this machine: where they are, who may use them, and who is at the other end of one."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import ipaddress
import os
import pwd
import socket
import stat
import struct
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import ActingOperator
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

SUFFIX = ".sock"
SERVICES = Path("/run/rsb-console")
"""The folder of bridges that systemd runs, `RuntimeDirectory=` of their unit."""
ISOLATED = "RSB_CONSOLE_ISOLATED"
"""With this environment variable, only the folder that the environment names is searched (docs/attach.md)."""
_BACKLOG = 16
"""Consoles that wait to be accepted. A round figure: further ones try again (`try_connect`)."""
_LOCKED_WITHIN = 5.0
"""s. A round figure: the holder of the lock only probes or makes a socket, which never blocks, unless somebody has
stopped it."""
_PEER = struct.Struct("iII")  # pid, uid, gid: struct ucred of unix(7)


class SocketProblem(Wording):
    """Reasons why a control socket, or its folder, cannot be used."""

    OTHER = "{path}: {problem}"
    NOT_A_SOCKET = "{path}: exists, and is not a socket; name another path with --control"
    FOLDER_LOCKED = "another process holds the lock on the folder of the control socket: try again"
    FOLDER_OF_USER = "this folder is another user's (uid {uid}); remove it, or set XDG_RUNTIME_DIR"
    FOLDER_WRITABLE = "others may write to this folder (mode {mode:04o}); chmod 700 it"


class AttachProblem(Wording):
    """Reasons why a console is not attached, or not any more."""

    NOT_ATTACHED = "not attached: {why}"
    NOT_SERVED = "no bridge serves a socket here"
    SILENT = "the bridge does not answer"
    SILENT_FOR = "the bridge has not answered for {seconds:.0f} s"
    ENDED = "the bridge's process has ended, or has closed the connection"
    DETACHED = "detached from the bridge"
    OTHER_CONSOLES = "{count} consoles are attached already; close one of them"
    ON_SOCKET = "{where}: {problem}"


class ControlError(EngineError):
    """A control socket that cannot be used; the message gives the reason."""


class UnclearError(ControlError):
    """A name that fits several engines; the message lists them."""


class NotServedError(ControlError):
    """No process listens on a control socket."""


class StrangerError(ControlError):
    """The other side of a control socket is a user whom this process does not trust."""


class TakenError(ControlError):
    """A living process listens on the socket already."""


def serving_folder(environ: Mapping[str, str]) -> Path:
    """Return the folder that this process puts its socket in.

    systemd's own for a service (``$RUNTIME_DIRECTORY``), else the user's (``$XDG_RUNTIME_DIR/rsb-console``), else
    ``/tmp/rsb-console-UID``.
    """
    if service := environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(service)
    return _user_folder(environ)


def searched_folders(environ: Mapping[str, str]) -> list[Path]:
    """Return the folders that may have sockets of this user's bridges; with `ISOLATED`, only the environment's."""
    own = (serving_folder(environ), _user_folder(environ))
    return list(dict.fromkeys(own if environ.get(ISOLATED) else (*own, _fallback_folder(), SERVICES)))


def _user_folder(environ: Mapping[str, str]) -> Path:
    runtime = environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "rsb-console" if runtime else _fallback_folder()


def _fallback_folder() -> Path:
    return Path(f"/tmp/rsb-console-{os.geteuid()}")  # noqa: S108 -- its owner and mode are checked


def find_sockets(environ: Mapping[str, str]) -> list[Path]:
    """Return all sockets in the folders that can be read, living or not. Folders of strangers are left out."""
    found = []
    for folder in searched_folders(environ):
        with contextlib.suppress(OSError):
            if folder.stat().st_uid not in (0, os.geteuid()) and folder != SERVICES:
                continue
            sockets = (path for path in folder.iterdir() if path.suffix == SUFFIX)
            found += sorted(sockets, key=lambda path: path.stem)
    return found


def hidden_bridges(environ: Mapping[str, str]) -> int | None:
    """Return the uid of a user whose sockets this process cannot or does not list, or None."""
    for folder in searched_folders(environ):
        with contextlib.suppress(OSError):
            owner = folder.stat().st_uid
            if folder == SERVICES:
                if not os.access(folder, os.R_OK | os.X_OK):
                    return owner
            elif owner not in (0, os.geteuid()):
                return owner
    return None


def user_name(uid: int) -> str:
    """Name a user in a message: ``the user ros``, ``uid 1234`` where the system has no name."""
    return f"the user {name}" if (name := _name_of(uid)) else f"uid {uid}"


def run_as(uid: int) -> str:
    """Return the beginning of a command line that runs rsb-console as a user."""
    if uid == 0:
        return "sudo rsb-console …"
    name = _name_of(uid) or f"'#{uid}'"
    return f"sudo -u {name} rsb-console …"


def _name_of(uid: int) -> str:
    """Return a user's name, or an empty string if this system does not know the user, as in a container."""
    try:
        return sanitize_text(pwd.getpwuid(uid).pw_name)
    except KeyError:
        return ""


class ControlSocket:
    """A socket that listens, mode 0600, and the file that leads to it.

    Args:
        path: of the file. Its folder is made, mode 0700, if it is a default one.

    Raises:
        TakenError: a living process listens there.
        ControlError: the folder is unsafe, or no socket can be made there.
    """

    def __init__(self, path: Path, *, make_folder: bool) -> None:
        self.path = path
        with _folder(path.parent, make=make_folder) as folder, _reported(path):
            _lock(folder)  # nobody else probes, replaces or makes a socket here meanwhile
            if _is_socket(folder, path):
                if _listens(folder, path.name):
                    raise TakenError(f"{path}: another process serves this socket")
                os.unlink(path.name, dir_fd=folder)
            self.socket = socket.socket(socket.AF_UNIX)
            try:
                self.socket.bind(_address(folder, path.name))
                _close_to_others(folder, path)
                self.socket.listen(_BACKLOG)  # until here nobody can connect
            except BaseException:
                self.socket.close()
                raise
            self._inode = os.stat(path.name, dir_fd=folder).st_ino
        self.socket.setblocking(False)

    def close(self) -> None:
        """Stop listening, and remove the file unless another has taken its place."""
        with contextlib.suppress(OSError, ControlError), _folder(self.path.parent, make=False) as folder:
            _lock(folder)
            if os.stat(self.path.name, dir_fd=folder).st_ino == self._inode:
                os.unlink(self.path.name, dir_fd=folder)
        self.socket.close()


def connect(path: Path, timeout: float) -> socket.socket:
    """Connect to a control socket, whose server must be this user's or root's; to root, also that of a service.

    Args:
        timeout: s; remains the socket's own.

    Raises:
        StrangerError: another user serves it.
        ControlError: nothing listens there, or it may not be used.
    """
    with _reported(path):
        return _connect(path, timeout)


def try_connect(path: Path) -> socket.socket | None:
    """Connect without waiting. Return a socket that does not block, or None if the server's queue is full: try again.

    Polling is the only choice while the queue is full, because the kernel does not report when it has room.
    """
    with _reported(path):
        try:
            return _connect(path, 0.0)
        except BlockingIOError:
            return None


def _connect(path: Path, timeout: float) -> socket.socket:
    with _folder(path.parent, make=False) as folder:
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.settimeout(timeout)
            connection.connect(_address(folder, path.name))
            _, uid, _ = peer_of(connection)
            # Only root can make the services' folder, for a user that root chose. Any other user may pose as a bridge:
            # in a folder of /tmp that bears root's number, or under a path that somebody gives root.
            service = path.parent == SERVICES and uid == os.fstat(folder).st_uid and os.geteuid() == 0
            if not (may_control(uid) or service):
                raise StrangerError(f"{path}: served by {user_name(uid)}, not by this user: {run_as(uid)}")
        except BaseException:
            connection.close()
            raise
    return connection


def may_control(uid: int) -> bool:
    """Whether a user may control bridges of this process's user: that user and root may, for any mode of the files."""
    return uid in (0, os.geteuid())


def peer_of(connection: socket.socket) -> tuple[int, int, int]:
    """Return the pid, uid and gid of a Unix socket's other side, as the kernel noted them when it connected."""
    pid, uid, gid = _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    return pid, uid, gid


def close_lingering(transport: asyncio.WriteTransport, within: float) -> None:
    """Send what waits, and close once the other end has closed, or after `within` seconds.

    What was closed at once would fail the other end's next write, and asyncio then drops what it has not read yet.
    """
    try:
        transport.write_eof()
    except (OSError, NotImplementedError):  # it is broken, or the network knows no end of one direction
        transport.close()
    else:
        asyncio.get_running_loop().call_later(within, transport.abort)


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Say in words what the kernel refuses."""
    try:
        yield
    except TimeoutError:
        raise ControlError(f"{path}: its process does not answer") from None
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED):
            raise NotServedError(f"{path}: {AttachProblem.NOT_SERVED()}") from None
        raise ControlError(SocketProblem.OTHER(path=path, problem=error.strerror or error)) from None


@contextlib.contextmanager
def _folder(path: Path, *, make: bool) -> Iterator[int]:
    """Open a folder, and make sure that no other user can put a socket of their own there.

    Args:
        make: it is one of the default folders: make it, mode 0700, where it is missing; it must be this user's.
    """
    try:
        if make:
            path.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):
                path.mkdir(mode=0o700)
        # Anybody may put a link of a default folder's name into /tmp.
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | (os.O_NOFOLLOW if make else 0))
    except FileNotFoundError:
        raise NotServedError(f"{path}: {AttachProblem.NOT_SERVED()}") from None
    except OSError as error:
        raise ControlError(SocketProblem.OTHER(path=path, problem=error.strerror)) from None
    try:
        if problem := _folder_problem(os.fstat(handle), strict=make):
            raise ControlError(SocketProblem.OTHER(path=path, problem=problem))
        yield handle
    finally:
        os.close(handle)


def _lock(folder: int) -> None:
    deadline = time.monotonic() + _LOCKED_WITHIN
    while True:
        try:
            # flock itself has no timeout.
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise ControlError(SocketProblem.FOLDER_LOCKED()) from None
            time.sleep(0.01)
        else:
            return


def _folder_problem(status: os.stat_result, *, strict: bool) -> str:
    others = stat.S_IMODE(status.st_mode) & 0o022
    if status.st_uid not in (0, os.geteuid()) and os.geteuid() != 0:
        return "this folder is another user's; remove it, or set XDG_RUNTIME_DIR"
    if strict and status.st_uid != os.geteuid():
        return SocketProblem.FOLDER_OF_USER(uid=status.st_uid)
    # With the sticky bit, as /tmp has it, others can add files, but replace none.
    if others and not status.st_mode & stat.S_ISVTX:
        return SocketProblem.FOLDER_WRITABLE(mode=stat.S_IMODE(status.st_mode))
    return ""


def _is_socket(folder: int, path: Path) -> bool:
    """Whether there is a socket of that name. A file of another kind is never removed."""
    try:
        mode = os.stat(path.name, dir_fd=folder, follow_symlinks=False).st_mode
    except FileNotFoundError:
        return False
    if not stat.S_ISSOCK(mode):
        raise ControlError(SocketProblem.NOT_A_SOCKET(path=path))
    return True


def _close_to_others(folder: int, path: Path) -> None:
    """Give a socket of this process mode 0600, and nothing that the folder's owner may have put in its place."""
    handle = os.open(path.name, os.O_PATH | os.O_NOFOLLOW, dir_fd=folder)
    try:
        status = os.fstat(handle)
        if not stat.S_ISSOCK(status.st_mode) or status.st_uid != os.geteuid():
            raise ControlError(SocketProblem.NOT_A_SOCKET(path=path))
        os.chmod(f"/proc/self/fd/{handle}", 0o600)  # noqa: PTH101 -- of this descriptor; there is no fchmod of a path's
    finally:
        os.close(handle)


def _listens(folder: int, name: str) -> bool:
    """Whether a living process listens on a socket, however busy it is."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        return probe.connect_ex(_address(folder, name)) not in (errno.ECONNREFUSED, errno.ENOENT)


def _address(folder: int, name: str) -> str:
    """Return a path for the kernel: of 107 bytes at most, and through the folder that was checked."""
    return f"/proc/self/fd/{folder}/{name}"


_PTS_MAJOR, _PTS_MAJORS, _PTS_OF_ONE_MAJOR = 136, 8, 256
_TTY_MAJOR, _CONSOLES = 4, 64
"""Device numbers of terminals (the kernel's devices.txt). Of major 4, virtual consoles come before serial ports."""
_NO_LOGIN = 2**32 - 1
_FIELDS_BEFORE_TTY = 4  # of /proc/PID/stat (proc_pid_stat(5)), behind the name in parentheses
_ENVIRONMENT_LIMIT = 1 << 20
"""Bytes that are read of a process's environment, which its user makes as long as the kernel allows. A round figure."""


def identify(pid: int, uid: int, proc: Path = Path("/proc")) -> ActingOperator:
    """Return the person behind a process: ``anna on pts/3 from 192.168.1.5``, or ``anna (uid 1000, pid 4711)``.

    A person who became another user since logging in, as with sudo, is named too: ``root for anna on pts/3``. The
    address comes from the environment that the SSH server gave the process; it is unknown for another user's process.

    Args:
        proc: the file system of processes.
    """
    process = proc / str(pid)
    name, login, terminal = _name_of(uid), _login(process), _terminal(process)
    account, who = f"uid {uid}", name or f"uid {uid}"
    if login is not None and login != uid:
        account += f" for uid {login}"
        who += f" for {_name_of(login) or f'uid {login}'}"
    if not terminal:
        return ActingOperator(account, who, f"({f'uid {uid}, ' if name else ''}pid {pid})")
    address = _ssh_client(process)
    return ActingOperator(account, who, f"on {terminal}" + (f" from {address}" if address else ""))


def _login(process: Path) -> int | None:
    """Return the user who logged in, before any `su` or `sudo`, or None if it is unknown."""
    try:
        uid = int((process / "loginuid").read_text())
    except (OSError, ValueError):
        return None
    return None if uid == _NO_LOGIN else uid


def _terminal(process: Path) -> str:
    """Return the process's controlling terminal, or an empty string."""
    try:
        # The process's name, in parentheses, may contain blanks and parentheses.
        number = int((process / "stat").read_bytes().rpartition(b")")[2].split()[_FIELDS_BEFORE_TTY])
    except (OSError, ValueError, IndexError):
        return ""
    major, minor = number >> 8 & 0xFFF, number & 0xFF | number >> 12 & 0xFFF00
    if _PTS_MAJOR <= major < _PTS_MAJOR + _PTS_MAJORS:
        return f"pts/{minor + _PTS_OF_ONE_MAJOR * (major - _PTS_MAJOR)}"
    if major == _TTY_MAJOR:
        return f"tty{minor}" if minor < _CONSOLES else f"ttyS{minor - _CONSOLES}"
    return f"terminal {major}:{minor}" if number else ""


def _ssh_client(process: Path) -> str:
    """Return the address that the process's user came from, or an empty string if it is unknown."""
    try:
        with (process / "environ").open("rb") as file:
            variables = file.read(_ENVIRONMENT_LIMIT).split(b"\0")
    except OSError:
        return ""
    for variable in variables:
        name, _, value = variable.partition(b"=")
        if name == b"SSH_CONNECTION":
            try:
                # The user may have set any text: only an address gets into the log.
                return str(ipaddress.ip_address(value.split()[0].decode()))
            except (ValueError, IndexError):
                return ""
    return ""
