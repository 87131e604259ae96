"""Endpoints with figures that no message of ours may carry: the link stays up, and topics are listed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from tests.support.bridge import carries, happened, linked, route
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

SHORT = QoSProfile(depth=10, deadline=Duration(nanoseconds=500_000), lifespan=Duration(nanoseconds=200_000))


def test_deadlines_and_lifespans_below_a_millisecond(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out = robot.publisher("/chat", qos=SHORT)
    robot.publisher("/elsewhere", qos=SHORT)
    there = pc.listener("/chat")
    pc.listener("/chat", qos=SHORT)
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])

    def heard() -> list[bytes]:
        out.publish(text("hello"))  # again and again: each lives for 0.2 ms, and may be gone before it is taken
        return there.payloads

    assert set(eventually(heard)) == {text("hello")}
    eventually(lambda: route(client, "/chat").subscriber_qos and route(server, "/chat").publisher_qos)
    for engine, name in ((client, None), (server, "robot1")):

        def listed(engine: Engine = engine, name: str | None = name) -> list[float]:
            topics = {each.topic: each.qos for each in engine.topics(name).result(60)}
            return [qos.deadline for topic in ("/elsewhere", "/chat") if (qos := topics.get(topic)) is not None]

        assert eventually(lambda listed=listed: found if len(found := listed()) == 2 else None) == [0.001, 0.001]
    assert linked(client)
    assert linked(server)
    for engine in (client, server):
        assert not happened(engine, EventCode.LINK_LOST)
