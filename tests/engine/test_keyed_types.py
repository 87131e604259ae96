"""Types with a key (@key), which distributions from Kilted on have. `test_another_dds` has a side without the type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import test_msgs.msg
from rclpy.serialization import deserialize_message
from tests.support.bridge import route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

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
