"""What is wrong stands in words on the screens of both sides, in real terminals."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.console.live import COMMAND, Pair, talker
from tests.console.tmux import Tmux

from rsb_bridge.config.keys import fingerprint, read_key, write_key
from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.control import Machine

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="it needs tmux (apt install tmux)")

CHATTER = f"/console_{os.getpid()}/both"


@dataclasses.dataclass
class Screens:
    """The consoles of both sides.

    Attributes:
        client: the robot's.
        server: the control PC's.
    """

    client: Tmux
    server: Tmux

    def say(self, client: str, server: str) -> None:
        """Wait until both say so; a sentence may be broken at the end of a line, and is cut where it has no room."""
        self.client.wait_for(client)
        self.server.wait_for(server)


@pytest.fixture
def pair(tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Pair:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    return Pair(tmp_path, Topic(CHATTER, "transmit"))


@pytest.fixture
def screens(pair: Pair, tmp_path: Path) -> Iterator[Screens]:
    with both(pair, tmp_path) as made:
        yield made


@contextlib.contextmanager
def both(pair: Pair, folder: Path) -> Iterator[Screens]:
    """The console of each side, in a terminal of its own."""
    for role in ("client", "server"):
        (folder / role).mkdir()
    with (
        Tmux(folder / "server", str(COMMAND), "run", str(pair.server_path)) as server,
        Tmux(folder / "client", str(COMMAND), "run", str(pair.client_path)) as client,
    ):
        yield Screens(client, server)


def test_nobody_listens_and_then_the_publisher_stops(screens: Screens) -> None:
    screens.say("● LINKED", "● LINKED")
    screens.say("◌ 1 wait", "◌ 1 wait")
    screens.say("no publisher of", "robot1: no publisher")
    with talker(CHATTER):
        screens.say("◇ 1 unheard", "◇ 1 unheard")
        screens.say("server: nobody subscribes to", "nobody subscribes to")
    screens.say("1 topic ", "1 topic ")
    screens.say("▲ 1 stale", "▲ 1 stale")
    screens.say("no publisher of", "robot1: nothing for")


def test_two_clients_of_one_name(screens: Screens, pair: Pair, tmp_path: Path) -> None:
    screens.say("● LINKED", "● LINKED")
    other = pair.client_path.with_name("other.yaml")
    save(msgspec.structs.replace(load(pair.client_path), topics=()), other)
    folder = tmp_path / "second"
    folder.mkdir()
    control = str(folder / "second.sock")
    with Tmux(folder, str(COMMAND), "run", str(other), "--control", control) as second:
        second.wait_for("'robot1' is linked already, since")
        screens.say("● LINKED", "robot1: a second client, from 127.0.0.1")


def test_the_keys_differ(pair: Pair, tmp_path: Path) -> None:
    ours = fingerprint(read_key(tmp_path / "robot1.key"))
    write_key(tmp_path / "other.key")
    theirs = fingerprint(read_key(tmp_path / "other.key"))
    save(msgspec.structs.replace(load(pair.client_path), key_file="other.key"), pair.client_path)
    with both(pair, tmp_path) as screens:
        for screen in (screens.client, screens.server):
            screen.wait_for("✗ robot1: ")
            screen.wait_for("the keys of 'robot1' differ")
            screen.wait_for(f"{theirs} on the client, {ours}")
