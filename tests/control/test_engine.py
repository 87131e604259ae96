"""A real engine under attached consoles: they see and change it, and none of them costs it a message."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.control.test_attaching import Stalled, consoles
from tests.support.bridge import carries, heard, linked
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain

    from rsb_bridge.control.client import RemoteEngine

pytest.importorskip("rclpy", reason="needs ROS 2")

WATCHES = """
import sys, time
from pathlib import Path
from rsb_bridge.control.client import RemoteEngine
remote = RemoteEngine(Path(sys.argv[1]))
remote.start()
print("attached", flush=True)
while True:
    remote.snapshot()
    time.sleep(0.1)
"""


def shown(remote: RemoteEngine, topic: str) -> RouteSnapshot | None:
    """A topic, as a console shows it at this moment."""
    return next((route for route in remote.snapshot().routes if route.topic == topic), None)


def test_it_is_seen_and_changed_from_elsewhere(bridge: Bridge, machine: Machine) -> None:
    _, client = bridge.both(Topic("/tcp", "transmit", type="std_msgs/msg/String"))
    machine.serve(client)
    remote = machine.attach()
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


def test_consoles_that_are_many_stalled_or_killed_cost_no_message(
    bridge: Bridge, robot: Domain, pc: Domain, machine: Machine
) -> None:
    topics = [Topic(f"/topic{number}_tcp", "transmit", type="std_msgs/msg/String") for number in range(5)]
    server, client = bridge.both(*topics)
    machine.serve(client)
    listeners = [pc.listener(topic.topic) for topic in topics]
    publishers = [robot.publisher(topic.topic) for topic in topics]
    carries(publishers, server, [topic.topic for topic in topics])

    stalled = Stalled(machine)
    remotes = [machine.attach() for _ in range(20)]
    command = [sys.executable, "-c", WATCHES, str(machine.folder / "robot1.sock")]
    with contextlib.closing(stalled.connection), subprocess.Popen(command, stdout=subprocess.PIPE) as killed:
        assert killed.stdout
        assert killed.stdout.readline() == b"attached\n"
        assert consoles(machine) == 22
        for number in range(200):
            for publisher in publishers:
                publisher.publish(_text(number))
            for remote in remotes:
                remote.snapshot()
            if number == 100:
                killed.kill()
        for listener in listeners:
            assert len(heard(listener, 200)) == 200
        eventually(lambda: consoles(machine) == 21, what="the killed one is gone")
        for remote in remotes:
            eventually(lambda r=remote: sum(route.ledger.delivered for route in r.snapshot().routes) == 1000)
    assert sum(route.ledger.dropped_total for route in client.snapshot().routes) == 0


def _text(number: int) -> bytes:
    from tests.support.domain import text

    return text(f"message {number}")
