"""A real engine under attached consoles: they see and change it, and none of them costs it a message."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any, Self

import pytest
from tests.control.attaching_helpers import Stalled, consoles
from tests.support.bridge import carries, heard, linked
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain

    from rsb_bridge.control.remote_engine import RemoteEngine

pytest.importorskip("rclpy", reason="needs ROS 2")

WATCHES = """
import sys, time
from pathlib import Path
from rsb_bridge.control.remote_engine import RemoteEngine
remote = RemoteEngine(Path(sys.argv[1]))
remote.start()
print("attached", flush=True)
said = False
while True:
    delivered = sum(route.ledger.delivered for route in remote.snapshot().routes)
    if delivered and delivered == int(sys.argv[2]) and not said:
        print("delivered", flush=True)
        said = True
    time.sleep(0.1)
"""


def shown(remote: RemoteEngine, topic: str) -> RouteSnapshot | None:
    return next((route for route in remote.snapshot().routes if route.topic == topic), None)


def test_it_is_seen_and_changed_from_elsewhere(bridge: Bridge, machine: Machine) -> None:
    _, client = bridge.both(Topic("/tcp", "transmit", type="std_msgs/msg/String"))
    remote = machine.attach_to(client)
    eventually(lambda: remote.snapshot().links[0].state is State.OK)
    assert [route.topic for route in remote.snapshot().routes] == ["/tcp"]
    eventually(lambda: any(event.code == EventCode.LINK_UP for event in remote.events()))

    key = remote.add_topic(Topic("/more", "transmit", type="std_msgs/msg/String")).result(30)
    more = shown(remote, "/more")
    assert more is not None, "the state that the command made is there when the command is done"
    assert more.key == key
    assert remote.session == client.session
    remote.pause(key, True).result(30)
    paused = shown(remote, "/more")
    assert paused is not None
    assert paused.state is State.PAUSED
    key = remote.edit_topic(key, Topic("/more", "transmit", type="std_msgs/msg/String", max_rate=2.0)).result(30)
    edited = shown(remote, "/more")
    assert edited is not None
    assert edited.spec.max_rate == 2.0
    remote.remove_topic(key).result(30)
    assert shown(remote, "/more") is None
    steps: list[str] = []
    remote.restart(steps.append).result(60)
    assert steps
    eventually(lambda: linked(client))


class Traffic:
    """Five topics over a bridge, whose client has a control socket; every message has to arrive, with any consoles."""

    def __init__(self, bridge: Bridge, robot: Domain, pc: Domain, machine: Machine) -> None:
        topics = [Topic(f"/topic{number}_tcp", "transmit", type="std_msgs/msg/String") for number in range(5)]
        server, self.client = bridge.both(*topics)
        machine.serve(self.client)
        self._listeners = [pc.listener(topic.topic) for topic in topics]
        self._publishers = [robot.publisher(topic.topic) for topic in topics]
        carries(self._publishers, server, [topic.topic for topic in topics])
        self._published = 0

    def flow(self, messages: int, looking: Sequence[RemoteEngine] = ()) -> None:
        """Publish so many on each topic, while consoles look at the bridge; all of them arrive."""
        for _ in range(messages):
            for publisher in self._publishers:
                publisher.publish(_text(self._published))
            for remote in looking:
                remote.snapshot()
            self._published += 1
        for listener in self._listeners:
            assert len(heard(listener, self._published)) == self._published
        assert sum(route.ledger.dropped_total for route in self.client.snapshot().routes) == 0

    @property
    def delivered(self) -> int:
        return len(self._listeners) * self._published


@pytest.fixture
def traffic(bridge: Bridge, robot: Domain, pc: Domain, machine: Machine) -> Traffic:
    return Traffic(bridge, robot, pc, machine)


class Watching:
    """A console in a process of its own, which polls all the time, and prints a line when it sees so many delivered."""

    def __init__(self, machine: Machine, delivered: int) -> None:
        command = [sys.executable, "-c", WATCHES, str(machine.folder / "robot1.sock"), str(delivered)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)
        self.says("attached")

    def says(self, line: str) -> None:
        assert self.process.stdout
        assert self.process.stdout.readline() == f"{line}\n".encode()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


def delivered(remote: RemoteEngine) -> int:
    return sum(route.ledger.delivered for route in remote.snapshot().routes)


def test_twenty_consoles_and_deaf_one_cost_no_message(traffic: Traffic, machine: Machine) -> None:
    with contextlib.closing(Stalled(machine).connection):
        remotes = [machine.attach() for _ in range(20)]
        assert consoles(machine) == 21
        traffic.flow(200, looking=remotes)
        for remote in remotes:
            eventually(lambda r=remote: delivered(r) == traffic.delivered)


def test_console_stopped_for_30_s_costs_no_message(traffic: Traffic, machine: Machine) -> None:
    """The 30 s pass on the clock of the bridge's control thread."""
    remote = machine.attach()
    with Watching(machine, 500) as watching:
        watching.process.send_signal(signal.SIGSTOP)
        traffic.flow(50, looking=[remote])
        for _ in range(30):
            pass_a_second(machine)
            remote.snapshot()
        traffic.flow(50, looking=[remote])
        assert consoles(machine) == 2, "its place is kept"
        watching.process.send_signal(signal.SIGCONT)
        watching.says("delivered")
        eventually(lambda: delivered(remote) == traffic.delivered == 500)
        watching.process.kill()
        traffic.flow(50, looking=[remote])
        eventually(lambda: consoles(machine) == 1, what="the killed one is gone")
        eventually(lambda: delivered(remote) == traffic.delivered)


def pass_a_second(machine: Machine) -> None:
    """Let a second pass for the control thread, which does its regular work then."""
    loop: Any = machine.served[-1].loop
    passed, real = threading.Event(), loop.time

    def jump() -> None:
        loop.time = lambda: real() + 1.0
        loop.call_later(0.3, passed.set)  # longer than a tick

    loop.call_soon_threadsafe(jump)
    assert passed.wait(60)


def _text(number: int) -> bytes:
    from tests.support.domain import text

    return text(f"message {number}")
