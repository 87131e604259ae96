"""Copying inside tmux, where that does not answer."""

import shutil
import subprocess
from pathlib import Path

import pytest
from tests.console.driving import on_main, until
from textual.pilot import Pilot

from rsb_console.app import ConsoleApp


@pytest.mark.parametrize("failure", [subprocess.TimeoutExpired("tmux", 2), subprocess.CalledProcessError(1, "tmux")])
def test_what_tmux_refuses_is_left_to_terminal(
    failure: Exception, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise failure

    @on_main()
    async def test(app: ConsoleApp, pilot: Pilot[None]) -> None:
        monkeypatch.setenv("TMUX", str(tmp_path / "socket"))
        monkeypatch.setattr(shutil, "which", lambda _: "tmux")
        monkeypatch.setattr(subprocess, "run", fail)
        await pilot.press("y")
        await until(pilot, lambda: app.clipboard == "/robot2/scan", "the topic's name, copied")

    test()
