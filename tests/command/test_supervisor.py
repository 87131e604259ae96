"""Messages to systemd: ready once, the bridge's state when it changes, and the watchdog only while the bridge works."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.console.scripted import ScriptedEngine

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level
from rsb_console.command.headless import Supervisor, bridge_until_told

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot


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


def test_an_engine_that_hangs_is_not_reported_alive(capfd: pytest.CaptureFixture[str]) -> None:
    """It is asked for nothing: who looks has each route's figures renewed, and is told that time goes on."""
    signals = SimpleNamespace(caught="", wants_reload=False, hung_up=False)
    shown = list[float]()

    class Hangs(ScriptedEngine):
        looks = 0

        def snapshot(self) -> Snapshot:
            self.looks += 1
            return replace(self.now, time=self.now.time + self.looks)

        def recorded(self) -> Snapshot:
            return self.now

        def wait_for_events(self, after: int, timeout: float) -> list[Event]:
            return [Event(after + 1, 0.0, Level.DEBUG, EventCode.ENGINE_STOPPED, "")]

    class Systemd(Supervisor):
        def show(self, now: Snapshot) -> None:
            shown.append(now.time)
            if len(shown) == 10:
                signals.caught = "SIGTERM"
            super().show(now)

    engine = Hangs()
    bridge_until_told(engine, cast("Any", signals), status_every=1e6, supervisor=Systemd({}))
    assert set(shown) == {engine.now.time}
    assert not engine.looks
