"""Messages to systemd: ready once, the bridge's state when it changes, and the watchdog only while the bridge works."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path

import pytest
from tests.console.scripted import ScriptedEngine

from rsb_console.command.headless import Supervisor


@pytest.mark.parametrize("abstract", [False, True], ids=["path", "abstract"])
def test_what_systemd_hears(tmp_path: Path, abstract: bool) -> None:
    name = f"@{tmp_path.name}-{id(tmp_path)}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{name[1:]}" if abstract else name)
        systemd.settimeout(10)
        supervisor, now = Supervisor({"NOTIFY_SOCKET": name}), ScriptedEngine().now
        status = "STATUS=1/1 linked, 8 topics: 1 down, 1 stale, 1 paused, 5 ok"
        supervisor.ready()
        supervisor.show(now)
        supervisor.show(now)  # the engine has not renewed it: it may hang
        supervisor.show(replace(now, time=now.time + 1))
        supervisor.reloading(1_234_567_890)
        supervisor.stopping()
        assert [systemd.recv(1000).decode() for _ in range(5)] == [
            "READY=1",
            f"WATCHDOG=1\n{status}",
            "WATCHDOG=1",
            "RELOADING=1\nMONOTONIC_USEC=1234567",
            "STOPPING=1",
        ]
        systemd.setblocking(False)
        with pytest.raises(BlockingIOError):
            systemd.recv(1000)


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": "/nonexistent"}])
def test_without_systemd_nothing_happens(environ: dict[str, str]) -> None:
    Supervisor(environ).ready()
