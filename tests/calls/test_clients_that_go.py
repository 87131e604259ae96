"""Callers that end while their calls are in flight leave nothing behind."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import balanced, called, counts, nothing_left
from tests.support.bridge import carries, heard, linked
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.domain import Domain


def test_leaving_client_disturbs_no_topic_or_caller(
    bridge: Bridge,
    robot: Domain,
    pc: Domain,
    near: CallNode,
    far: CallNode,
    another: Callable[[int], CallNode],
    service: str,
) -> None:
    """Closed or killed; its answers go to nobody. As zenoh-plugin-ros2dds #413: the topics went down with it."""
    talker, ear = robot.publisher("/beside"), pc.listener("/beside")
    far.serve(service, delay=(0.5, 1.0))
    engines = server, client = bridge.both(called(service), Topic("/beside", "transmit", type="String"))
    carries([talker], server, ["/beside"])
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 100, at_once=20)
        for kill in (False, True):
            short_lived = another(bridge.robot.id)
            short_lived.waits_for(service)
            arrived = counts(server, service).asked
            short_lived.begin(service, 30, at_once=30)
            eventually(lambda arrived=arrived: counts(server, service).asked >= arrived + 30, what="all arrived")
            if kill:
                short_lived.kill()
            else:
                short_lived.give_up(service)
        said = len(ear.payloads)
        for number in range(20):
            talker.publish(text(f"{number}"))
        heard(ear, said + 20)
        outcome = near.settled(service)
        assert outcome.right, outcome
        assert near.call(service, 20, at_once=20).right
        assert linked(client)
        assert far.served(service).again == 0
    eventually(lambda: not counts(client, service).in_flight)
    nothing_left(*engines)
