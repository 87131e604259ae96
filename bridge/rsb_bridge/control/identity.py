"""Who is behind a process, as the kernel knows it: the user, the terminal, and where they came from."""

from __future__ import annotations

import ipaddress
import pwd
from pathlib import Path

from rsb_bridge.model.text import sanitize_text

_PTS_MAJOR, _PTS_MAJORS, _PTS_OF_ONE_MAJOR = 136, 8, 256
_TTY_MAJOR, _CONSOLES = 4, 64
"""Device numbers of terminals (the kernel's devices.txt). Of major 4, virtual consoles come before serial ports."""
_NO_LOGIN = 2**32 - 1
_FIELDS_BEFORE_TTY = 4  # of /proc/PID/stat (proc_pid_stat(5)), behind the name in parentheses
_ENVIRONMENT_LIMIT = 1 << 20


def identify(pid: int, uid: int, proc: Path = Path("/proc")) -> str:
    """Who is behind a process: ``anna on pts/3 from 192.168.1.5``, ``anna (uid 1000, pid 4711)`` without a terminal.

    Who became another user since logging in, as with sudo, is named too: ``root for anna on pts/3``. The address is
    what the SSH server left in the process's environment; of another user's process, it is not known.

    Args:
        pid: of the process.
        uid: its user's.
        proc: the file system of processes.
    """
    process = proc / str(pid)
    user, login, terminal = _user(uid), _login(process), _terminal(process)
    who = f"{user} for {_user(login)}" if login is not None and login != uid else user
    if not terminal:
        return f"{who} ({'' if user == _unnamed(uid) else f'uid {uid}, '}pid {pid})"
    address = _ssh_client(process)
    return f"{who} on {terminal}" + (f" from {address}" if address else "")


def _user(uid: int) -> str:
    try:
        return sanitize_text(pwd.getpwuid(uid).pw_name)
    except KeyError:  # a user that this system does not know, as in a container
        return _unnamed(uid)


def _unnamed(uid: int) -> str:
    return f"uid {uid}"


def _login(process: Path) -> int | None:
    """The user who logged in, whoever they have become since; None: it is not known."""
    try:
        uid = int((process / "loginuid").read_text())
    except (OSError, ValueError):
        return None
    return None if uid == _NO_LOGIN else uid


def _terminal(process: Path) -> str:
    """The process's controlling terminal; empty: it has none."""
    try:
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
    """The address that the process's user came from; empty: it is not known."""
    try:
        with (process / "environ").open("rb") as file:
            variables = file.read(_ENVIRONMENT_LIMIT).split(b"\0")
    except OSError:
        return ""
    for variable in variables:
        name, _, value = variable.partition(b"=")
        if name == b"SSH_CONNECTION":
            try:
                return str(ipaddress.ip_address(value.split()[0].decode()))
            except (ValueError, IndexError):
                return ""
    return ""
