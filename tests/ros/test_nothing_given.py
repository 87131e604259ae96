"""Endpoints that DDS reports as ready for ever, and that give nothing: they rest, and then fail."""

from __future__ import annotations

import ctypes
import queue
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import constants, replaced
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.native.librcl import NO_REQUEST, NO_RESPONSE, TAKE_FAILED, Serialized
from rsb_bridge.ros.ros_interface import RosError, RosProblem, TopicSpec

if TYPE_CHECKING:
    from rclpy.node import Node
    from tests.support.places import Place

    from rsb_bridge.ros.node import RosNode

STRING, SET = "std_msgs/msg/String", "std_srvs/srv/SetBool"


@pytest.fixture(autouse=True)
def _rests_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.NOTHING_A_SECOND.set(monkeypatch, 0)


class _Takes:
    """Counts how often something is taken, while nothing is given instead."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, place: Place, code: int) -> None:
        self.count = 0
        self.gives_nothing = True
        take = place.value

        def counted(*args: Any) -> int:
            self.count += 1
            if not self.gives_nothing:
                given: int = take(*args)
                return given
            if not code:
                ctypes.cast(args[1], ctypes.POINTER(Serialized)).contents.length = 0  # a message without a byte
            return code

        place.set(monkeypatch, counted)


@pytest.mark.parametrize(
    ("told", "code"), [("events", 0), ("sharing", 0), ("wait set", 0), ("wait set", TAKE_FAILED)], indirect=["told"]
)
@pytest.mark.usefixtures("told")
def test_subscription_rests_and_fails(
    open_node: Callable[..., RosNode], rclpy_node: Node, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    from std_msgs.msg import String

    node, taken, failures = open_node(), list[Any](), list[RosError]()
    takes = _Takes(monkeypatch, replaced.TAKE_MESSAGE, code)
    node.subscribe(TopicSpec("/hollow", STRING, "", Qos()), taken.extend, "link", failures.append)
    publisher = rclpy_node.create_publisher(String, "/hollow", 10)
    eventually(publisher.get_subscription_count)
    publisher.publish(String(data="a"))
    eventually(lambda: failures)
    assert says(str(failures[0]), RosProblem.NOTHING_GIVEN)
    assert not taken
    assert takes.count < 20


@pytest.mark.usefixtures("told")
def test_subscription_that_recovers_goes_on(
    open_node: Callable[..., RosNode], rclpy_node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_msgs.msg import String

    node, taken, failures = open_node(), list[Any](), list[RosError]()
    takes = _Takes(monkeypatch, replaced.TAKE_MESSAGE, 0)
    node.subscribe(TopicSpec("/hollow", STRING, "", Qos()), taken.extend, "link", failures.append)
    publisher = rclpy_node.create_publisher(String, "/hollow", 10)
    eventually(publisher.get_subscription_count)
    for number in range(1, 4):
        before, takes.gives_nothing = takes.count, True
        publisher.publish(String(data="a"))
        eventually(lambda before=before: takes.count >= before + 5)
        takes.gives_nothing = False
        eventually(lambda number=number: len(taken) == number)
    assert not failures


@pytest.mark.usefixtures("told")
def test_others_are_served_meanwhile(
    open_node: Callable[..., RosNode], rclpy_node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_msgs.msg import String
    from std_srvs.srv import SetBool

    node, requests, failures = open_node(), list[Any](), list[RosError]()
    _Takes(monkeypatch, replaced.TAKE_MESSAGE, 0)
    node.subscribe(TopicSpec("/hollow", STRING, "", Qos()), print, "link", failures.append)
    node.serve("/set", SET, "", requests.extend)
    publisher = rclpy_node.create_publisher(String, "/hollow", 10)
    client = rclpy_node.create_client(SetBool, "/set")
    eventually(lambda: publisher.get_subscription_count() and client.service_is_ready())
    publisher.publish(String(data="a"))
    while not failures:
        before = len(requests)
        client.call_async(SetBool.Request())
        eventually(lambda before=before: len(requests) > before)
    assert len(requests) > 10


@pytest.mark.parametrize("told", ["wait set"], indirect=True)
@pytest.mark.usefixtures("told")
def test_server_and_client_rest_and_fail(open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch) -> None:
    provider, caller = open_node(name="provider"), open_node(name="caller")
    asked = _Takes(monkeypatch, replaced.TAKE_REQUEST, NO_REQUEST)
    answered = _Takes(monkeypatch, replaced.TAKE_RESPONSE, NO_RESPONSE)
    requests, failures = list[Any](), list[RosError]()
    server = provider.serve("/set", SET, "", requests.extend, failures.append)
    client = caller.call_service("/set", SET, "", print, failures.append)
    eventually(lambda: client.ready)
    client.call(b"\0\1\0\0\0\0\0\0")
    eventually(lambda: len(failures) == 1)
    assert asked.count < 20

    server.close()
    asked.gives_nothing = False
    server = provider.serve("/set", SET, "", requests.extend)
    eventually(lambda: client.ready)
    client.call(b"\0\1\0\0\0\0\0\0")
    eventually(lambda: requests)
    server.answer(requests[0].caller, b"\0\1" + bytes(11))
    eventually(lambda: len(failures) == 2)
    assert answered.count < 20
    assert all(says(str(each), RosProblem.NOTHING_GIVEN) for each in failures)


def test_announced_nothing_is_looked_at_once(
    open_node: Callable[..., RosNode], rclpy_node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By events, DDS that gives nothing is asked again only once something else comes."""
    from std_msgs.msg import String
    from std_srvs.srv import SetBool

    node, taken, others, failures = open_node(), list[Any](), list[Any](), list[RosError]()
    takes = _Takes(monkeypatch, replaced.TAKE_MESSAGE, TAKE_FAILED)
    node.subscribe(TopicSpec("/hollow", STRING, "", Qos()), taken.extend, "link", failures.append)
    node.serve("/other", SET, "", others.extend)
    publisher, client = rclpy_node.create_publisher(String, "/hollow", 10), rclpy_node.create_client(SetBool, "/other")
    eventually(lambda: publisher.get_subscription_count() and client.service_is_ready())
    publisher.publish(String(data="a"))
    for number in range(1, 31):  # each turns the loop once or more
        client.call_async(SetBool.Request())
        eventually(lambda number=number: len(others) >= number)
    assert takes.count <= 5  # when it was made, when the message came: not once for each turn
    takes.gives_nothing = False
    publisher.publish(String(data="b"))
    eventually(lambda: len(taken) == 2)
    assert takes.count <= 10
    assert not failures


def test_answers_of_other_clients_are_no_fault(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    """DDS reports them to each client of a service, and gives it nothing."""
    monkeypatch.undo()
    provider, busy, idle = open_node(name="provider"), open_node(name="busy"), open_node(name="idle")
    takes = _Takes(monkeypatch, replaced.TAKE_RESPONSE, NO_RESPONSE)
    takes.gives_nothing = False
    answers, idle_answers, failures = list[Any](), list[Any](), list[RosError]()
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def asked(batch: Sequence[Any]) -> None:
        for each in batch:
            requests.put(each)

    server = provider.serve("/set", SET, "", asked)
    client = busy.call_service("/set", SET, "", answers.extend)
    other: Any = idle.call_service("/set", SET, "", idle_answers.extend, failures.append)
    eventually(lambda: client.ready and other.ready)
    for number in range(1, 31):
        client.call(b"\0\1\0\0\0\0\0\0")
        server.answer(requests.get(timeout=60).caller, b"\0\1" + bytes(11))
        eventually(lambda number=number: len(answers) == number)
    eventually(lambda: takes.count > 60)  # of each answer at least one by either client
    other.call(b"\0\1\0\0\0\0\0\0")
    server.answer(requests.get(timeout=60).caller, b"\0\1" + bytes(11))
    eventually(lambda: idle_answers)
    assert not failures
    assert not other.rests_until
