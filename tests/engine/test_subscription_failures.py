"""A subscription that fails while it runs: both sides say so, and it is there again by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.bridge import carries, happened, heard, route, stage
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.api import RosError

if TYPE_CHECKING:
    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

FAILURE = "/chat: a message could not be taken (rcl error 1)"


def break_subscription(engine: Engine, topic: str) -> None:
    """Have the next message of a topic not be taken, as where rcl finds the subscription broken."""
    assert engine._bridge is not None

    def fail(*_: object) -> None:
        raise RosError(FAILURE)

    [subscription] = [each for each in engine._bridge.context.ros._subscriptions.values() if each.topic == topic]  # type: ignore[attr-defined]
    subscription.reader.take = fail


def test_both_sides_say_so_until_it_is_there_again(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Long enough to be seen on any machine.
    monkeypatch.setattr("rsb_bridge.ros.lasting_subscription._FIRST_DELAY", 10.0)
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])
    out.publish(text("before"))
    heard(there, 1)
    break_subscription(client, "/chat")
    out.publish(text("lost"))
    for engine in (client, server):
        eventually(lambda engine=engine: route(engine, "/chat").state == "down")
        assert route(engine, "/chat").reason == FAILURE
        assert stage(engine, "/chat", "subscribed") is False
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_SUBSCRIBE_FAILED, FAILURE))
    eventually(lambda: happened(client, EventCode.ROUTE_CONNECTED, "again"))
    eventually(lambda: out.get_subscription_count() == 1)
    out.publish(text("after"))
    assert heard(there, 2) == [text("before"), text("after")]
    for engine in (client, server):
        eventually(lambda engine=engine: route(engine, "/chat").state == "ok")
        eventually(lambda engine=engine: stage(engine, "/chat", "subscribed"))


def test_the_shutdown_topic_is_heard_again(bridge: Bridge, robot: Domain) -> None:
    out = robot.publisher("/shutdown")
    client = bridge.client()
    eventually(lambda: out.get_subscription_count() == 1)
    break_subscription(client, "/shutdown")
    out.publish(text("shutdown"))
    eventually(lambda: happened(client, EventCode.ENGINE_SUBSCRIBE_FAILED, FAILURE))

    def shut_down() -> bool:
        out.publish(text("shutdown"))
        return client.waits_for_operator

    eventually(shut_down)
