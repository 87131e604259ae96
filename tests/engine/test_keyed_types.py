"""Types with a key (@key), which distributions from Kilted on have. `test_another_dds` has a side without the type."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
import test_msgs.msg
from rclpy.serialization import deserialize_message
from tests.support.bridge import route
from tests.support.cyclone import KEYED_STRING, CycloneProgram
from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

if not hasattr(test_msgs.msg, "KeyedString"):
    pytest.skip("this distribution has no type with a key", allow_module_level=True)

KeyedString: Any = getattr(test_msgs.msg, "KeyedString", None)


def test_messages_cross_with_key(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher, listener = robot.publisher("/keyed", KeyedString), pc.listener("/keyed", KeyedString)
    server, client = bridge.both(Topic("/keyed", "transmit"))
    sent = KeyedString(key="a", value="b")

    def crosses() -> bool:
        publisher.publish(sent)
        return bool(listener.payloads)

    eventually(crosses)
    assert deserialize_message(listener.payloads[0], KeyedString) == sent
    for side in server, client:
        eventually(lambda side=side: route(side, "/keyed").state == "ok")


def test_more_keys_cross_than_fast_dds_keeps_by_default(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It keeps messages of 10, and refuses the others'."""
    keys = [f"key {number}" for number in range(40)]
    publisher, listener = robot.publisher("/keyed", KeyedString), pc.listener("/keyed", KeyedString)
    bridge.both(Topic("/keyed", "transmit"))

    def heard() -> set[str]:
        return {deserialize_message(payload, KeyedString).key for payload in listener.payloads}

    def crosses() -> bool:
        publisher.publish(KeyedString(key=keys[0]))
        return bool(listener.payloads)

    eventually(crosses)
    for key in keys[1:]:
        publisher.publish(KeyedString(key=key))
        eventually(lambda key=key: key in heard())


def test_another_dds_with_key_is_not_subscribed_to(bridge: Bridge, robot: Domain) -> None:
    """Fast DDS (3.2.3) cannot be trusted with its messages."""
    with closing(CycloneProgram(robot.id)) as near:
        writer = near.writer("/keyed", Qos(), KEYED_STRING)
        server, client = bridge.both(Topic("/keyed", "transmit"))
        for side in server, client:
            eventually(lambda side=side: route(side, "/keyed").cause == Cause.TYPE_CONFLICT)
            assert "publish it with Fast DDS, or a type without a key" in route(side, "/keyed").reason
        assert writer.matched == 0


def test_another_dds_with_key_ends_the_subscription(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It appears beside a node's publisher, whose messages cross, and cross again once it has gone."""
    publisher, listener = robot.publisher("/keyed", KeyedString), pc.listener("/keyed", KeyedString)
    server, client = bridge.both(Topic("/keyed", "transmit"))

    def crosses() -> bool:
        publisher.publish(KeyedString(key="a", value="b"))
        return bool(listener.payloads)

    eventually(crosses)
    with closing(CycloneProgram(robot.id)) as near:
        writer = near.writer("/keyed", Qos(), KEYED_STRING)
        for side in server, client:
            eventually(lambda side=side: route(side, "/keyed").cause == Cause.TYPE_CONFLICT)
            assert "publish it with Fast DDS, or a type without a key" in route(side, "/keyed").reason
        eventually(lambda: publisher.get_subscription_count() == 0)
        assert writer.matched == 0
    listener.payloads.clear()
    eventually(crosses)
