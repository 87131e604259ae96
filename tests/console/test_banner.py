"""The lines of faults on a real terminal, while the nodes behind them are silent."""

from __future__ import annotations

import shutil
import signal
import time
from contextlib import ExitStack
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from tests.console.live import COMMAND, HERE, Pair, running
from tests.console.nodes import Spec, encoded
from tests.console.tmux import Tmux

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_console.look.glyphs import STATE_SIGN, STATE_WORD

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="it needs tmux (apt install tmux)")

RATES = {"/front": 20.0, "/rear": 20.0, "/left": 10.0, "/right": 10.0}
SECONDS = 10
HEAD = " TOPIC "
"""Of the table."""
LOOKS = 8
"""Looks at the screen in a second, each of which starts a process."""


def banner(picture: str) -> list[str]:
    """The lines between the totals and the table."""
    lines = picture.splitlines()
    top = next(number for number, line in enumerate(lines) if HEAD in line)
    return [line.rstrip() for line in lines[2:top]]


def test_its_lines_stay_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four topics of one node that hangs: each is reported by itself, or together with one of the same verdict."""
    pytest.importorskip("rclpy", reason="needs ROS 2")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    topics = [Topic(name, "transmit", expected_rate=rate) for name, rate in RATES.items()]
    pair = Pair(tmp_path, *topics, stale_after=120.0)
    specs = encoded([Spec("driver", name, rate) for name, rate in RATES.items()])
    with ExitStack() as stack:
        stack.enter_context(pair.server())
        nodes = stack.enter_context(running("tests.console.nodes", str(HERE), specs))
        command = str(COMMAND), "run", str(pair.client_path)
        screen = stack.enter_context(Tmux(tmp_path, *command, size=(80, 36)))
        screen.wait_for(f"{len(RATES)} {STATE_WORD[State.UNHEARD].lower()}")  # nobody listens on the far side
        nodes.send_signal(signal.SIGUSR1)
        stopped = f"{STATE_SIGN[State.STOPPED]} {len(RATES)} {STATE_WORD[State.STOPPED].lower()}"
        screen.wait_for(stopped)
        frames: list[list[str]] = []
        began = time.monotonic()
        while (now := time.monotonic() - began) < SECONDS:
            picture = screen.picture
            assert stopped in picture
            if now > 1.0:
                frames.append(banner(picture))
            time.sleep(1 / LOOKS)
    assert {len(frame) for frame in frames} == {len(frames[0])}, frames
    signs = {tuple(line[:3].strip() for line in frame) for frame in frames}
    assert len(signs) == 1, signs
    changes = sum(one != other for one, other in pairwise(frames))
    assert changes <= 2 * SECONDS, f"{changes} in {SECONDS} s"  # once a second; a look may come while it is drawn
