"""Standard output that nobody reads, or that is full for a while: the bridge goes on, and ends on request."""

from __future__ import annotations

import array
import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from tests.support.bridge import Bridge, happened, linked
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode

ENDS_WITHIN = 60.0


def started(session: Path, stdout: int) -> subprocess.Popen[bytes]:
    """The program, which writes a status line every 20 ms."""
    command = [sys.executable, "-m", "rsb_console", "run", "--no-ui", "--log-format", "json", "--status-every", "0.02"]
    return subprocess.Popen([*command, str(session)], stdin=subprocess.DEVNULL, stdout=stdout)


@pytest.fixture
def session(bridge: Bridge) -> Path:
    path = bridge.folder / "client.yaml"
    save(bridge.client_session(), path)
    return path


def test_a_pipe_that_nobody_reads(bridge: Bridge, session: Path) -> None:
    """SIGTERM ends the program in time, its peer gets the goodbye, and the output has whole lines."""
    server = bridge.server()
    reader, writer = os.pipe()
    room = fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with started(session, writer) as program:
        os.close(writer)
        try:
            eventually(lambda: linked(server))
            eventually(lambda: unread(reader) > room - 512, what="the pipe is full")
            program.send_signal(signal.SIGTERM)
            eventually(lambda: happened(server, EventCode.LINK_CLOSED_BY_PEER), ENDS_WITHIN)
            assert program.wait(ENDS_WITHIN) == 0
        finally:
            program.kill()
            os.close(reader)


def unread(pipe: int) -> int:
    """Bytes in a pipe."""
    count = array.array("i", [0])
    fcntl.ioctl(pipe, termios.FIONREAD, count)
    return count[0]


def test_a_disk_that_is_full_for_a_while(bridge: Bridge, session: Path) -> None:
    """The file may not grow any more, as on a full disk; once it may, the log goes on and says what is missing."""
    path = bridge.folder / "client.log"
    output = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    with started(session, output) as program:
        os.close(output)
        try:
            eventually(lambda: b'"status"' in path.read_bytes())
            program.send_signal(signal.SIGSTOP)  # it writes no line between the look and the limit
            os.waitpid(program.pid, os.WUNTRACED)
            full = path.stat().st_size + 10  # in the middle of a line
            resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (full, resource.RLIM_INFINITY))
            program.send_signal(signal.SIGCONT)
            eventually(lambda: path.stat().st_size == full)
            server = bridge.server()
            eventually(lambda: linked(server), what="the bridge goes on")
            resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            eventually(lambda: EventCode.LOG_LINES_LOST.encode() in path.read_bytes(), what="it is said")
            eventually(lambda: path.read_bytes().rpartition(b"lines_lost")[2].count(b'"status"') > 2, what="it goes on")
        finally:
            program.send_signal(signal.SIGTERM)
            assert program.wait(ENDS_WITHIN) == 0
    lines = path.read_bytes().splitlines()
    torn = [line for line in lines if not line.endswith(b"}")]
    assert len(torn) == 1, "the one that was being written when the disk was full"
    events = [json.loads(line) for line in lines if line not in torn]
    (said,) = [event for event in events if event.get("code") == EventCode.LOG_LINES_LOST]
    assert said["text"].endswith("log lines lost: File too large")
