"""Copying inside tmux, where that does not answer."""

import subprocess
from pathlib import Path

import pytest
from tests.console.driving import on_main, until
from tests.support import replaced
from textual.pilot import Pilot

from rsb_console.app import ConsoleApp


@pytest.mark.parametrize("failure", [subprocess.TimeoutExpired("tmux", 2), subprocess.CalledProcessError(1, "tmux")])
def test_what_tmux_refuses_is_left_to_terminal(
    failure: Exception, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "tmux").touch(mode=0o755)

    def fail(*_: object, **__: object) -> None:
        raise failure

    @on_main()
    async def test(app: ConsoleApp, pilot: Pilot[None]) -> None:
        monkeypatch.setenv("TMUX", str(tmp_path / "socket"))
        monkeypatch.setenv("PATH", str(tmp_path))
        replaced.RUN_TMUX.set(monkeypatch, fail)
        await pilot.press("y")
        await until(pilot, lambda: app.clipboard == "/robot2/scan", "the topic's name, copied")

    test()
