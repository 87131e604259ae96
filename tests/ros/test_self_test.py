"""The program with ROS libraries that `rsb_bridge.ros.native` was not made for.

Stand-ins for other distributions: arguments that are refused, structs that are laid out otherwise, missing symbols.
"""

from __future__ import annotations

import os
import struct
import threading
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.cdr.known_types import STRING, stamped_string
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros import self_test
from rsb_bridge.ros.distribution import described, package_of
from rsb_bridge.ros.native import librcl, rclpy_extension
from rsb_bridge.ros.ros_interface import EndPlace, RosError, RosProblem, TopicSpec
from rsb_bridge.ros.self_test import Findings, Shortfall, findings

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.node import RosNode

SET = "std_srvs/srv/SetBool"
_TYPE_HASH = "RIHS01_" + "12" * 32


def found_anew(monkeypatch: pytest.MonkeyPatch) -> Findings:
    """Test again, and have new nodes go by the result."""
    found = self_test.test()
    for place in (replaced.PARTICIPANT_FINDINGS, replaced.FINDINGS):
        place.set(monkeypatch, lambda: found)
    return found


def _refuses(*_arguments: object) -> Any:
    raise TypeError("incompatible constructor arguments")


def test_everything_holds_here() -> None:
    assert findings().node is rclpy_extension.ExtensionNode
    assert not findings().shortfalls


@pytest.mark.parametrize("refusing", ["node", "subscription", "service", "publisher", "client"])
def test_other_arguments_lead_to_the_public_classes(
    refusing: str, monkeypatch: pytest.MonkeyPatch, open_node: Callable[..., RosNode]
) -> None:
    if refusing == "node":
        replaced.EXTENSION_NODE.set(monkeypatch, _refuses)
    else:
        monkeypatch.setitem(replaced.EXTENSION_CLASSES.value, refusing, _refuses)
    found = found_anew(monkeypatch)
    assert found.node is rclpy_extension.PublicNode
    assert found.public_only == Shortfall.PUBLIC_CLASSES(
        distribution=described(), error="incompatible constructor arguments"
    )
    here, there = open_node(), open_node(name="other")
    received: list[Any] = []
    there.subscribe(TopicSpec("/chatter", STRING, "", Qos()), received.extend, "link")
    publisher = here.advertise(TopicSpec("/chatter", STRING, "", Qos()), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(stamped_string(100))
    eventually(lambda: received)
    requests: list[Any] = []
    responses: list[Any] = []
    server = there.serve("/set", SET, "", requests.extend)
    client = here.call_service("/set", SET, "", responses.extend)
    eventually(lambda: client.ready)
    client.call(b"\0\1\0\0\1")
    eventually(lambda: requests)
    server.answer(requests[0].caller, b"\0\1\0\0\1\0\0\0\1\0\0\0\0")
    eventually(lambda: responses)


def test_endpoints_outlive_their_mirrored_node(
    monkeypatch: pytest.MonkeyPatch, open_node: Callable[..., RosNode]
) -> None:
    """With the public classes, too: what is armed stays on its node, and others until theirs is made."""
    replaced.EXTENSION_NODE.set(monkeypatch, _refuses)
    assert found_anew(monkeypatch).node is rclpy_extension.PublicNode
    here, there = open_node(), open_node(name="other")
    received: list[Any] = []
    chatter, echo = (TopicSpec(topic, STRING, "", Qos()) for topic in ("/chatter", "/echo"))
    here.mirrors.add("/front/lidar")
    here.mirrors.place(EndPlace("publisher", "/chatter", "link"), "/front/lidar")
    here.mirrors.place(EndPlace("subscription", "/echo", "link"), "/front/lidar")
    publisher = here.advertise(chatter, "link")
    subscription = here.subscribe(echo, received.extend, "link")
    there.subscribe(chatter, received.extend, "link")
    echoes = there.advertise(echo, "link")
    eventually(lambda: publisher.subscriber_count and echoes.subscriber_count, what="matched")
    eventually(there.mirrors.by_others, what="the mirrored node")
    here.mirrors.remove("/front/lidar")
    publisher.publish(stamped_string(100))
    echoes.publish(stamped_string(100))
    eventually(lambda: len(received) == 2, what="both messages")
    publisher.close()
    subscription.close()
    eventually(lambda: not there.mirrors.by_others(), what="its end")


@pytest.mark.parametrize("layout", ["@8xqqQQP16s", "@qqQQ16sP"])
def test_other_layout_of_message_info_is_refused(layout: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a message's publisher, a bridge would take its own messages for others'."""
    replaced.MESSAGE_INFO.set(monkeypatch, struct.Struct(layout))
    with pytest.raises(RosError, match=pattern(RosProblem.LACKS, name="rmw_message_info_t")):
        self_test.test()


def test_calls_that_do_not_cross_leave_messages_alone(
    monkeypatch: pytest.MonkeyPatch, open_node: Callable[..., RosNode]
) -> None:
    replaced.COPIES_CALLS.set(monkeypatch, lambda: False)
    found = found_anew(monkeypatch)
    assert not found.no_messages
    assert found.shortfalls == (Shortfall.CALLS(distribution=described(), error="Fast CDR"),)
    node = open_node()
    node.advertise(TopicSpec("/any", "no_such_msgs/msg/Any", _TYPE_HASH, Qos()), "link")
    node.serve("/set", SET, "", lambda _: None)


@pytest.mark.parametrize("code", [3, 0], ids=["refused", "untold"])
def test_arrivals_that_are_not_told_are_waited_for(
    code: int, monkeypatch: pytest.MonkeyPatch, open_node: Callable[..., RosNode]
) -> None:
    monkeypatch.setitem(replaced.ON_ARRIVAL.value, "subscription", lambda *_: code)
    found = found_anew(monkeypatch)
    assert found.shortfalls == (found.no_arrivals,)
    assert found.no_arrivals
    here, there = open_node(), open_node(name="other")
    received: list[Any] = []
    there.subscribe(TopicSpec("/chatter", STRING, "", Qos()), received.extend, "link")
    publisher = here.advertise(TopicSpec("/chatter", STRING, "", Qos()), "link")
    eventually(lambda: publisher.subscriber_count)
    for number in range(1, 11):
        publisher.publish(stamped_string(100))
        eventually(lambda number=number: len(received) == number)


def test_without_std_msgs_installed_types_cross(
    monkeypatch: pytest.MonkeyPatch, open_node: Callable[..., RosNode]
) -> None:
    replaced.SELF_TEST_INSTALLED_CLASS.set(monkeypatch, lambda _: None)
    found = found_anew(monkeypatch)
    assert found.shortfalls == (RosProblem.NO_STRINGS(package=package_of("std_msgs")),)
    open_node().advertise(TopicSpec("/chatter", STRING, "", Qos()), "link")


def test_nodes_that_start_at_once_leave_environment_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    replaced.SELF_TEST_FINDINGS.set(monkeypatch, self_test.test)
    starting = [threading.Thread(target=findings) for _ in range(4)]
    for each in starting:
        each.start()
    for each in starting:
        each.join()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_a_missing_function_is_named() -> None:
    function = librcl.function("rcl_no_such_function")
    with pytest.raises(RosError, match=pattern(RosProblem.LACKS, name="rcl_no_such_function")):
        function(1, 2)
    with pytest.raises(RosError, match=pattern(RosProblem.LACKS, name="rclpy's NoSuchClass")):
        rclpy_extension.named("NoSuchClass")(1)
