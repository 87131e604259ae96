"""The user of a process, as the kernel reports it, not the process."""

from __future__ import annotations

import os
import pty
import pwd
import sys
from pathlib import Path

import pytest

from rsb_bridge.control.control_sockets import identify

ME = pwd.getpwuid(os.getuid()).pw_name
_NAMED_TO_DECEIVE = "4711 (x) R 1 1 1 1025 1"


def a_process(proc: Path, tty: int, login: str = "4294967295", environment: bytes = b"") -> None:
    """A process as /proc shows it; its name is what it likes."""
    folder = proc / "4711"
    folder.mkdir()
    (folder / "stat").write_text(f"4711 ({_NAMED_TO_DECEIVE}) S 1 4711 4711 {tty} 4711 0 0")
    (folder / "loginuid").write_text(login)
    (folder / "environ").write_bytes(environment)


@pytest.mark.parametrize(
    ("tty", "terminal"),
    [
        (136 << 8 | 3, "pts/3"),
        (137 << 8 | 4, "pts/260"),
        (4 << 8 | 1, "tty1"),
        (4 << 8 | 65, "ttyS1"),
        (188 << 8 | 2, "terminal 188:2"),
    ],
)
def test_the_terminal(tty: int, terminal: str, tmp_path: Path) -> None:
    a_process(tmp_path, tty)
    assert str(identify(4711, os.getuid(), tmp_path)) == f"{ME} on {terminal}"


def test_a_process_without_a_terminal(tmp_path: Path) -> None:
    a_process(tmp_path, 0)
    assert str(identify(4711, os.getuid(), tmp_path)) == f"{ME} (uid {os.getuid()}, pid 4711)"
    assert str(identify(4711, 123_456_789, tmp_path)) == "uid 123456789 (pid 4711)"


def test_a_process_that_has_gone(tmp_path: Path) -> None:
    assert str(identify(4711, os.getuid(), tmp_path)) == f"{ME} (uid {os.getuid()}, pid 4711)"


def test_who_became_another_user(tmp_path: Path) -> None:
    a_process(tmp_path, 136 << 8 | 3, login="123456789")
    assert str(identify(4711, os.getuid(), tmp_path)) == f"{ME} for uid 123456789 on pts/3"


@pytest.mark.parametrize(
    ("value", "origin"),
    [
        (b"192.168.1.5 50022 192.168.1.9 22", " from 192.168.1.5"),
        (b"fe80::1%eth0 50022 fe80::2 22", " from fe80::1%eth0"),
        (b"otto on pts/9 from nowhere", ""),
        (b"\x1b[2J", ""),
        (b"\xff\xfe", ""),
        (b"", ""),
    ],
)
def test_where_they_came_from(value: bytes, origin: str, tmp_path: Path) -> None:
    """Only an address is believed."""
    a_process(tmp_path, 136 << 8 | 3, environment=b"HOME=/root\0SSH_CONNECTION=" + value + b"\0TERM=xterm")
    assert str(identify(4711, os.getuid(), tmp_path)) == f"{ME} on pts/3{origin}"


def test_a_process_on_a_real_terminal() -> None:
    pid, terminal = pty.fork()
    if not pid:
        os.execv(sys.executable, [sys.executable, "-c", "print('up', flush=True); input()"])
    try:
        assert os.read(terminal, 2) == b"up"
        name = str(Path(f"/proc/{pid}/fd/0").readlink()).removeprefix("/dev/")
        assert f" on {name}" in str(identify(pid, os.getuid()))
    finally:
        os.close(terminal)
        os.waitpid(pid, 0)
