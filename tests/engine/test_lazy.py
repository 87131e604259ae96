"""Lazy topics: a camera that encodes only while somebody listens rests until somebody on the other side does."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from tests.engine.peeking_helpers import key
from tests.support.bridge import happened, route
from tests.support.domain import BEST_EFFORT, LATCHED, RELIABLE
from tests.support.inside import inside
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.route.lazy import KEPT_FOR

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine


class Camera:
    """A camera that encodes only while somebody listens.

    Attributes:
        encoded: images so far.
    """

    def __init__(self, domain: Domain, qos: QoSProfile = BEST_EFFORT) -> None:
        self._publisher = domain.publisher("/image", Image, qos)
        self._image = serialize_message(Image(height=1, width=900, step=900, data=bytes(900)))
        self.encoded = 0

    @property
    def listeners(self) -> int:
        count: int = self._publisher.get_subscription_count()
        return count

    def see(self) -> None:
        """Encode an image if somebody listens."""
        if self.listeners:
            self.encoded += 1
            self._publisher.publish(self._image)


def rests(*engines: Engine) -> bool:
    return all(route(engine, "/image").state is State.RESTING for engine in engines)


def ledger_of(engine: Engine) -> Any:
    return route(engine, "/image").ledger


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_rests_until_somebody_there_subscribes(protocol: str, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    camera = Camera(robot)
    server, client = bridge.both(Topic("/image", "transmit", protocol=protocol, lazy=True))
    eventually(lambda: rests(client, server))
    assert {route(engine, "/image").cause for engine in (client, server)} == {Cause.RESTING}
    assert happened(client, EventCode.ROUTE_RESTING)
    camera.see()
    assert camera.encoded == 0

    listener = pc.listener("/image", Image, BEST_EFFORT)
    eventually(lambda: camera.listeners == 1)

    def comes() -> bool:
        camera.see()
        return bool(listener.payloads)

    eventually(comes)
    eventually(lambda: route(client, "/image").state is State.OK and route(server, "/image").state is State.OK)

    left_at = time.monotonic()
    pc.node.destroy_subscription(listener.subscription)
    eventually(lambda: camera.listeners == 0)
    assert time.monotonic() - left_at >= KEPT_FOR
    eventually(lambda: rests(client, server))
    encoded = camera.encoded
    camera.see()
    assert camera.encoded == encoded
    eventually(lambda: ledger_of(client).open == 0)
    assert ledger_of(client).lost_in_dds == ledger_of(client).missed_while_down == 0


def test_listener_that_starts_again_finds_subscription(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    camera = Camera(robot)
    bridge.both(Topic("/image", "transmit", lazy=True))
    listener = pc.listener("/image", Image, BEST_EFFORT)
    eventually(lambda: camera.listeners == 1)
    pc.node.destroy_subscription(listener.subscription)
    pc.listener("/image", Image, BEST_EFFORT)
    holds(lambda: camera.listeners == 1, KEPT_FOR + 2)


@pytest.mark.parametrize(
    ("qos", "keys"),
    [(LATCHED, {}), (RELIABLE, {"keep": 5.0}), (RELIABLE, {"arm": True}), (RELIABLE, {"lazy": None})],
    ids=["latched", "kept", "armed", "not lazy"],
)
def test_does_not_rest(qos: QoSProfile, keys: dict[str, Any], bridge: Bridge, robot: Domain) -> None:
    camera = Camera(robot, qos)
    _, client = bridge.both(Topic("/image", "transmit", **{"lazy": True, **keys}))
    if keys.get("arm"):
        eventually(lambda: route(client, "/image").state is State.DISARMED)
    else:
        eventually(lambda: camera.listeners == 1)


@pytest.mark.parametrize(("lazy", "expected"), [(None, True), (False, False)])
def test_profile_has_images_rest(lazy: bool | None, expected: bool, bridge: Bridge, robot: Domain) -> None:
    camera = Camera(robot)
    chat = robot.publisher("/chat")
    topics = Topic("/image", "transmit", lazy=lazy), Topic("/chat", "transmit")
    _, client = bridge.both(*topics, profile="lte")
    eventually(chat.get_subscription_count)
    eventually(lambda: rests(client) if expected else camera.listeners)


def test_changes_while_it_is_open(bridge: Bridge, robot: Domain) -> None:
    camera = Camera(robot)
    _, client = bridge.both(Topic("/image", "transmit"))
    eventually(lambda: camera.listeners == 1)
    connected = route(client, "/image").messages_total, client.events()[-1].number
    client.edit_topic(key(client, "/image"), Topic("/image", "transmit", lazy=True)).result(60)
    eventually(lambda: camera.listeners == 0)
    event = happened(client, EventCode.ROUTE_AMENDED, "lazy as the profile says → yes")
    assert event is not None
    assert event.number > connected[1]
    client.edit_topic(key(client, "/image"), Topic("/image", "transmit")).result(60)
    eventually(lambda: camera.listeners == 1)


@pytest.mark.parametrize("side", ["here", "there"])
def test_look_of_operator_wakes_it(side: str, bridge: Bridge, robot: Domain) -> None:
    camera = Camera(robot)
    server, client = bridge.both(Topic("/image", "transmit", lazy=True))
    eventually(lambda: rests(client, server))
    engine = client if side == "here" else server
    looks = engine.peek(key(engine, "/image"), kept=False)

    def comes() -> bool:
        camera.see()
        return looks.done()

    eventually(comes)
    assert looks.result() is not None
    eventually(lambda: camera.listeners == 0)
    eventually(lambda: rests(client, server))


def test_view_there_wakes_it(bridge: Bridge, robot: Domain) -> None:
    """A picture is drawn from a subscription of the bridge's own, which no publisher of the bridge counts."""
    camera = Camera(robot)
    server, client = bridge.both(Topic("/image", "transmit", lazy=True))
    eventually(lambda: rests(client, server))
    now = route(server, "/image")
    assert now.qos is not None
    spec = TopicSpec("/image", now.type_name, now.type_hash, now.qos)
    view = inside(server).context.ros.subscribe(spec, lambda _: None, ("view", 1))
    eventually(lambda: camera.listeners == 1)
    view.close()
    eventually(lambda: camera.listeners == 0)
