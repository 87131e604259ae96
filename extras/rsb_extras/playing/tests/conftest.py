"""A recording, a node that hears what is played, and the player at a terminal."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.command.conftest import here, ran
from tests.support.forker import Forked
from tests.support.waiting import eventually

from rsb_bridge.feature_api import Qos, TopicSpec
from rsb_bridge.ros.node import RosNode
from rsb_extras.playing.tests.recorded import Recorded

__all__ = ["here", "ran"]


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    return Recorded(tmp_path / "played.mcap")


class Hearing:
    """A node that takes raw messages of topics whose types need not be installed."""

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.node = RosNode(domain, "hearing")
        self.node.start()
        self._heard: dict[str, Any] = {}

    def hear(self, topic: str, type_name: str = "std_msgs/msg/String", type_hash: str = "", **qos: Any) -> list[Any]:
        type_hash = type_hash or self.node.installed_hash(type_name) or ""
        heard: list[Any] = []
        spec = TopicSpec(topic, type_name, type_hash, Qos(**{"depth": 1000, **qos}))
        self._heard[topic] = self.node.subscribe(spec, heard.extend, "test")
        return heard

    def wait_for(self, player: AtTerminal) -> None:
        """Wait until the player sees all subscriptions."""
        player.wait_for(f" {len(self._heard)} subscriptions")


@pytest.fixture
def hearing(spare_domains: int) -> Iterator[Hearing]:
    made = Hearing(spare_domains)
    yield made
    made.node.stop()


class AtTerminal:
    """``rsb-console`` with a terminal of its own, whose output is read all the time."""

    def __init__(self, *words: str) -> None:
        self._ours, theirs = pty.openpty()
        self._read = bytearray()
        self._ends = threading.Event()
        self.process = Forked("rsb_console", *words, stdin=theirs, stdout=theirs, stderr=theirs, terminal=True)
        os.close(theirs)
        self._reader = threading.Thread(target=self._follow)
        self._reader.start()

    def _follow(self) -> None:
        while not self._ends.is_set():
            if select.select((self._ours,), (), (), 0.05)[0]:
                try:
                    part = os.read(self._ours, 65536)
                except OSError:  # the process has ended
                    return
                self._read += part

    @property
    def text(self) -> str:
        return self._read.decode(errors="replace")

    def wait_for(self, words: str) -> None:
        eventually(lambda: words in self.text, what=f"{words!r} in {self.text!r}")

    def exit_code(self) -> int:
        """Wait for its end, and until all that it wrote is read."""
        eventually(lambda: self.process.poll() is not None)
        eventually(lambda: not self._reader.is_alive())
        return int(self.process.wait())

    def press(self, keys: str) -> None:
        os.write(self._ours, keys.encode())

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._ends.set()
        self._reader.join()
        os.close(self._ours)


@pytest.fixture
def at_terminal() -> Iterator[Any]:
    with contextlib.ExitStack() as stack:

        def start(*words: str) -> AtTerminal:
            started = AtTerminal(*words)
            stack.callback(started.close)
            return started

        yield start
