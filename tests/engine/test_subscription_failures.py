"""A subscription that fails while it runs: both sides show it, and the bridge subscribes again."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from tests.support import constants, replaced
from tests.support.bridge import carries, happened, heard, route, stage
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

FAILURE = RosProblem.NOT_TAKEN(topic="/chat", code=1)


def break_subscription(engine: Engine, topic: str) -> None:
    """Have the next message of a topic not be taken, as where rcl finds the subscription broken."""

    def fail(*_: object) -> None:
        raise RosError(FAILURE)

    there = inside(engine).context.ros._subscriptions  # type: ignore[attr-defined]
    found = eventually(lambda: [each for each in there() if each.topic == topic], what="subscribed")
    for subscription in found:
        subscription._take = fail


@contextlib.contextmanager
def refused(engine: Engine) -> Iterator[None]:
    """Meanwhile nothing can be subscribed to, as where rcl refuses it for the same reason."""
    ros, subscribe = inside(engine).context.ros, replaced.ROS_SUBSCRIBE.value

    def refuse(node: object, *arguments: object, **options: object) -> Any:
        if node is ros:
            raise RosError(FAILURE)
        return subscribe(node, *arguments, **options)

    with replaced.ROS_SUBSCRIBE.during(refuse):
        yield


def look_down(*engines: Engine) -> None:
    """Wait until both sides show that it is down."""
    for engine in engines:
        eventually(lambda engine=engine: route(engine, "/chat").state == "down")
        assert route(engine, "/chat").reason in (FAILURE, f"robot1: {FAILURE}", f"server: {FAILURE}")
        assert stage(engine, "/chat", "subscribed") is False
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_SUBSCRIBE_FAILED, FAILURE))


def test_both_sides_tell_until_it_is_there(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.SUBSCRIBED_AGAIN_WITHIN.set(monkeypatch, 0.5)
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])
    out.publish(text("before"))
    heard(there, 1)
    break_subscription(client, "/chat")
    with refused(client):
        out.publish(text("lost"))
        look_down(client, server)
    eventually(lambda: happened(client, EventCode.ROUTE_CONNECTED, "again"))

    def is_heard() -> bool:
        out.publish(text("after"))
        return len(there.payloads) > 1

    eventually(is_heard)
    assert set(there.payloads[1:]) == {text("after")}
    for engine in (client, server):
        eventually(lambda engine=engine: route(engine, "/chat").state == "ok")
        eventually(lambda engine=engine: stage(engine, "/chat", "subscribed"))


def test_the_shutdown_topic_is_heard_again(bridge: Bridge, robot: Domain) -> None:
    out = robot.publisher("/shutdown")
    client = bridge.client()
    break_subscription(client, "/shutdown")

    def said() -> bool:
        out.publish(text("shutdown"))  # again and again: nobody but the engine knows when it is matched
        return happened(client, EventCode.ENGINE_SUBSCRIBE_FAILED, FAILURE) is not None

    def shut_down() -> bool:
        out.publish(text("shutdown"))
        return client.waits_for_operator

    eventually(said)
    eventually(shut_down)
