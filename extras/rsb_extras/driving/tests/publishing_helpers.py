"""Helpers of `test_publishing` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import Twist
from msgspec.structs import replace
from rclpy.serialization import deserialize_message
from tests.support.bridge import is_accepted, route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_extras.driving.publish_requests import Publish

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.codes import EventCode
    from rsb_extras.driving.publish_requests import Published


STRING, TWIST, TWIST_STAMPED = "std_msgs/msg/String", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


DRIVEN = Topic("/cmd", "receive", arm=True, deadman=0.0)


def publish(engine: Engine, fields: str, topic: str = "/cmd", **more: object) -> Published:
    """Publish a message, with a ticket where it needs one."""
    published = engine.do(Publish(topic, fields, **more)).result(30)  # type: ignore[arg-type]
    if not published.is_done:
        again: dict[str, object] = {**more, "ticket": published.ticket}
        published = engine.do(Publish(topic, fields, **again)).result(30)  # type: ignore[arg-type]
    assert published.is_done
    return published


def can_be_armed(*engines: Engine) -> bool:
    return all(route(engine, "/cmd").state == "disarmed" and is_accepted(engine, "/cmd") for engine in engines)


def of(engine: Engine, code: EventCode) -> list[tuple[str, str, str]]:
    return [(event.topic, event.who, event.new) for event in engine.events() if event.code == code]


def speeds(listener: Listener) -> list[float]:
    return [deserialize_message(each, Twist).linear.x for each in listener.payloads]


def drive(engine: Engine, speed: float, rest_after: float = 0.5) -> Published:
    return publish(engine, f"linear: {{x: {speed}}}", rest="linear: {x: 0}", rest_after=rest_after)


def driven(
    bridge: Bridge, pc: Domain, consoles: Consoles, topic: Topic | None = None, of: type = Twist
) -> tuple[Engine, Engine]:
    """A server and a client with a topic that is armed on the server and may be driven."""
    pc.publisher("/cmd", of)
    server, client = bridge.both(topic or replace(DRIVEN, type=TWIST))
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    return server, client
