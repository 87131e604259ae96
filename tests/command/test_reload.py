"""A bridge in a process of its own reads its session file again: by command, and by SIGHUP where it has no terminal."""

from __future__ import annotations

import json
import os
import pty
import pwd
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.console.terminal import TAKE_TERMINAL
from tests.support.commands import Ran
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.session import Topic
from rsb_console.command.shell import HUNG_UP

COMMAND = str(Path(sys.executable).with_name("rsb-console"))
ENDS_WITHIN = 60.0


pytestmark = pytest.mark.usefixtures("here")


class Systemd:
    """The socket that systemd listens on, read all the time: the kernel keeps no more than ten messages for it."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self._heard: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def hear(self, beginning: str) -> str:
        while not (heard := self._heard.get(timeout=ENDS_WITHIN)).startswith(beginning):
            pass
        return heard

    def _listen(self) -> None:
        with self._socket:
            while heard := self._socket.recv(4096):
                self._heard.put(heard.decode())

    def close(self) -> None:
        """Read no more."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", str(self.path))
        self._thread.join()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    made = Systemd(tmp_path)
    yield made
    made.close()


def start(
    path: Path, environ: dict[str, str], terminal: int | None = None, *, nohup: bool = False
) -> subprocess.Popen[str]:
    """The program, in a session of its own: without a terminal, unless it is given one's descriptor."""
    first = [] if terminal is None else [sys.executable, "-c", TAKE_TERMINAL.format(terminal)]
    first += ["nohup"] if nohup else []
    return subprocess.Popen(
        [*first, COMMAND, "run", "--no-ui", "--log-format", "json", "--status-every", "3600", str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        pass_fds=() if terminal is None else (terminal,),
        env=os.environ | environ,
    )


def says(process: subprocess.Popen[str], code: str) -> Any:
    assert process.stdout
    return next(event for line in process.stdout if (event := json.loads(line)).get("code") == code)


def topics(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [each["topic"] for each in Ran(capsys, "topics", "--json").json["topics"]]


def test_sighup_without_a_terminal_and_the_command_reload(
    path: Path, systemd: Systemd, capsys: pytest.CaptureFixture[str]
) -> None:
    with start(path, {"NOTIFY_SOCKET": str(systemd.path)}) as process:
        try:
            systemd.hear("READY=1")
            session = load(path)
            save(msgspec.structs.replace(session, topics=(*session.topics, Topic("/map", "receive"))), path)
            before = time.monotonic_ns() // 1000
            process.send_signal(signal.SIGHUP)
            reloading = systemd.hear("RELOADING=1\n")
            name, _, moment = reloading.splitlines()[1].partition("=")
            assert name == "MONOTONIC_USEC"
            assert before <= int(moment) <= time.monotonic_ns() // 1000
            systemd.hear("READY=1")
            assert topics(capsys) == ["/scan", "/map"]
            event = says(process, "operator.reloaded")
            assert event["who"] == "SIGHUP"
            assert event["text"].startswith("reload by SIGHUP: /map (receive)")

            path.write_text(path.read_text() + "nonsense: 1\n")
            process.send_signal(signal.SIGHUP)
            systemd.hear("RELOADING=1\n")
            systemd.hear("READY=1")
            failed = says(process, "engine.reload_failed")
            assert failed["level"] == "ERROR"
            assert "robot1.yaml:" in failed["text"]
            assert "nonsense" in failed["text"]
            assert topics(capsys) == ["/scan", "/map"]

            save(msgspec.structs.replace(session, topics=(Topic("/scan", "transmit", max_rate=2.0),)), path)
            done = Ran(capsys, "reload")
            assert done.code == 0
            assert "/scan (transmit): max_rate none → 2.0" in done.out.splitlines()
            assert topics(capsys) == ["/scan"]
            user = pwd.getpwuid(os.getuid()).pw_name
            assert says(process, "operator.reloaded")["who"].startswith(user)
            path.write_text(path.read_text().replace("max_rate: 2", "max_rate: fast"))
            bad = Ran(capsys, "reload", "--json")
            assert bad.code == 1
            assert "robot1.yaml:" in bad.json["error"]
            assert "max_rate" in bad.json["error"]
            assert Ran(capsys, "stop").code == 0
            assert says(process, "operator.stopped")["who"].startswith(user)
            systemd.hear("STOPPING=1")
            assert process.wait(ENDS_WITHIN) == 0
        finally:
            process.kill()
    eventually(lambda: Ran(capsys, "status").code == 3)


def test_sighup_with_a_terminal_ends_the_bridge(path: Path, systemd: Systemd) -> None:
    """It says that the terminal has gone."""
    here, there = pty.openpty()
    environ = {"NOTIFY_SOCKET": str(systemd.path)}
    with start(path, environ, there) as process:
        try:
            systemd.hear("READY=1")
            os.close(here)
            os.close(there)
            assert process.wait(ENDS_WITHIN) == HUNG_UP
        finally:
            process.kill()


def test_nohup_keeps_the_bridge_when_the_terminal_goes(
    path: Path, systemd: Systemd, capsys: pytest.CaptureFixture[str]
) -> None:
    here, there = pty.openpty()
    with start(path, {"NOTIFY_SOCKET": str(systemd.path)}, there, nohup=True) as process:
        try:
            systemd.hear("READY=1")
            os.close(here)
            os.close(there)
            process.send_signal(signal.SIGHUP)
            # It waits (0) until its first attempt to connect has failed.
            eventually(lambda: Ran(capsys, "status", "--json").code == 1, what="it runs, and is not linked")
            process.terminate()
            assert process.wait(ENDS_WITHIN) == 0
            assert process.stdout
            assert '"text": "stopping: SIGTERM"' in process.stdout.read()
        finally:
            process.kill()
