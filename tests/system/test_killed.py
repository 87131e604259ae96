"""kill -9 of either side, at any moment, again and again."""

from __future__ import annotations

import gc
import random
import time
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import linked
from tests.support.domain import Domain, text
from tests.support.long import long
from tests.support.resources import resources
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Listener
    from tests.support.program import Programs

    from rsb_bridge.engine import Engine


@pytest.mark.parametrize("times", [9, *long(50)])
def test_again_and_again(times: int, bridge: Bridge, programs: Programs, robot: Domain, pc: Domain) -> None:
    """Two bridges at once, one whose client dies and one whose server does; the other halves live in this process.

    The victims are killed while they link, or once their topics are open, or while messages cross; each time the
    bridge opens again. How soon a client calls again is tested on a clock of the test's own (tests/link). A killed
    process leaves shared memory to clean up (docs/performance.md), so the robot's publisher is a new one each time,
    and none is killed while it joins its domain: it may hold a lock there.
    """
    chance = random.Random(1)
    topics = (
        Topic("/client_dies", "transmit", type="String", qos="default"),
        Topic("/server_dies", "transmit", type="String", qos="default", protocol="udp"),
    )
    listeners = [pc.listener(topic.topic) for topic in topics]
    steady = robot.publisher("/server_dies")
    server = bridge.server()
    mortal_client = bridge.client_session(topics[0])
    bridge.move()
    client = bridge.client(topics[1])
    mortal_server = bridge.server_session()

    def cycle(number: int) -> None:
        rebooted = Domain(robot.id)
        publishers = [rebooted.publisher("/client_dies"), steady]
        opened = [openings(engine) for engine in (server, client)]
        victims = [programs.start(mortal_client), programs.start(mortal_server)]
        for victim, first in zip(victims, ("connecting", "listening"), strict=True):
            victim.wait_for(first)
        if number % 3:
            eventually(lambda: openings(server) > opened[0] and openings(client) > opened[1])
        if number % 3 == 2:
            flow(publishers, listeners)
        end = time.monotonic() + chance.uniform(0, 0.2)
        while time.monotonic() < end:
            say(publishers)
        for victim in victims:
            victim.kill()
        rebooted.close()
        eventually(lambda: not linked(server) and not linked(client))

    settled = times // 5
    for number in range(settled):
        cycle(number)
    before = resources()
    for number in range(settled, times):
        cycle(number)
    eventually(
        lambda: all(now <= then for now, then in zip(resources()[:2], before[:2], strict=True)),
        what=f"threads and descriptors as {before}",
    )
    gc.collect()
    assert resources().resident - before.resident < 20 << 20


def openings(engine: Engine) -> int:
    """Return how often its topic was opened, up to the bridge's own last step."""
    return sum(event.code == EventCode.ROUTE_CONNECTED for event in engine.events())


def say(publishers: list[Publisher]) -> None:
    """One message on each topic."""
    for publisher in publishers:
        publisher.publish(text(f"{time.monotonic()}"))
    time.sleep(0.005)


def flow(publishers: list[Publisher], listeners: list[Listener]) -> None:
    """Publish until all listeners have heard something new."""
    before = [len(listener.payloads) for listener in listeners]

    def all_heard() -> bool:
        say(publishers)
        return all(len(listener.payloads) > count for listener, count in zip(listeners, before, strict=True))

    eventually(all_heard)
