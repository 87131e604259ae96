"""Answers to callers that DDS has not matched: kept for a while, in order, within bounds, and nobody waits for them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool
from tests.support import replaced
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.ros.native import librcl
from rsb_bridge.ros.ros_interface import RosError, RosProblem
from rsb_bridge.ros.service_endpoints import LateAnswers

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode

SET = "std_srvs/srv/SetBool"
ANSWER = serialize_message(SetBool.Response())


class Callers:
    """Some of whom are found, or cannot be answered at all; and the clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        self.found: set[bytes] = set()
        self.broken: set[bytes] = set()
        self.tried = 0
        self.answered: list[tuple[bytes, int]] = []
        replaced.SERVICE_TIME.set(monkeypatch, SimpleNamespace(monotonic=lambda: self.now))

    def send(self, caller: bytes, number: int, _: bytes) -> bool:
        self.tried += 1
        if caller in self.broken:
            raise RosError("broken")
        if caller in self.found:
            self.answered.append((caller, number))
        return caller in self.found


@pytest.fixture
def callers(monkeypatch: pytest.MonkeyPatch) -> Callers:
    return Callers(monkeypatch)


def test_callers_get_ordered_answers_independently(callers: Callers) -> None:
    late = LateAnswers(callers.send)
    callers.found.add(b"b")
    assert [late.send(caller, number, b"") for caller, number in ((b"a", 1), (b"a", 2), (b"b", 3))] == [0, 0, 1]
    assert late.try_again()
    callers.found.add(b"a")
    assert not late.send(b"a", 4, b"")  # behind the kept ones
    callers.now += 0.2
    assert not late.try_again()
    assert callers.answered == [(b"b", 3), (b"a", 1), (b"a", 2), (b"a", 4)]
    assert late.send(b"a", 5, b"")


def test_each_caller_is_tried_once_a_turn(callers: Callers) -> None:
    """DDS waits 100 ms for one that it has not matched."""
    late = LateAnswers(callers.send)
    for number in range(10):
        late.send(b"a", number, b"")
    late.send(b"b", 10, b"")
    callers.tried = 0
    for _ in range(5):
        assert late.try_again()
    assert callers.tried == 2
    callers.now += 0.2
    assert late.try_again()
    assert callers.tried == 4


def test_old_answers_are_given_up(callers: Callers) -> None:
    late = LateAnswers(callers.send)
    late.send(b"a", 1, b"")
    callers.now += 6
    late.send(b"a", 2, b"")
    callers.now += 6
    assert late.try_again()  # the second is not too old
    callers.found.add(b"a")
    callers.now += 0.2
    assert not late.try_again()
    assert callers.answered == [(b"a", 2)]


@pytest.mark.parametrize(("count", "size"), [(1000, 0), (16, 1 << 20)])
def test_so_many_are_kept_and_no_more(callers: Callers, count: int, size: int) -> None:
    late = LateAnswers(callers.send)
    for number in range(count):
        late.send(bytes((number % 2,)), number, bytes(size))
    with pytest.raises(RosError, match=pattern(RosProblem.TOO_MANY_ANSWERS_WAIT, count=count)):
        late.send(b"a", count, b"." if size else b"")
    callers.found |= {bytes(1), b"\1"}
    assert not late.try_again()
    assert len(callers.answered) == count
    assert not late.send(b"a", count, bytes(size))


def test_who_cannot_be_answered_is_given_up_alone(callers: Callers) -> None:
    late = LateAnswers(callers.send)
    late.send(b"a", 1, b"")
    late.send(b"b", 2, b"")
    callers.broken.add(b"a")
    callers.found.add(b"b")
    assert not late.try_again()
    assert callers.answered == [(b"b", 2)]
    with pytest.raises(RosError):
        late.send(b"a", 3, b"")


def test_unmatched_caller_holds_up_nobody(
    open_node: Callable[..., RosNode], stock: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It wants answers that were published before; nobody waits 100 ms for it, again and again."""
    sent: list[bytes] = []
    send_response = librcl.send_response

    def recording(address: int, caller: bytes, message: int) -> int:
        sent.append(caller)
        return int(send_response(address, caller, message))

    replaced.SEND_RESPONSE.set(monkeypatch, recording)
    ours = open_node()
    requests: list[Any] = []
    server = ours.serve("/set", SET, "", requests.extend)
    impossible = stock.create_client(
        SetBool, "/set", qos_profile=QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    eventually(lambda: stock.count_services("/set") and ours.callers("/set"))

    def asks() -> bool:
        impossible.call_async(SetBool.Request())
        return bool(requests)

    eventually(asks)  # that a server is there is not to be seen by this client
    refused = requests[0]
    server.answer(refused.caller, ANSWER)
    client = stock.create_client(SetBool, "/set")
    assert client.wait_for_service(60)
    future = client.call_async(SetBool.Request(data=True))

    def answered() -> bool:
        for each in requests:
            if each.caller[:16] != refused.caller[:16]:
                server.answer(each.caller, ANSWER)
        return bool(future.done())

    eventually(answered)
    assert refused.caller not in sent
    assert sent


def test_departing_server_takes_its_late_answers_along(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    ours = open_node()
    failures: list[str] = []
    ours.watch(lambda: None, failures.append)
    requests: list[Any] = []
    server = ours.serve("/set", SET, "", requests.extend)
    client = rclpy_node.create_client(SetBool, "/set")
    assert client.wait_for_service(60)
    client.call_async(SetBool.Request())
    eventually(lambda: requests)
    rclpy_node.destroy_client(client)
    eventually(lambda: not ours.callers("/set"))
    server.answer(requests[0].caller, ANSWER)  # is kept
    server.close()

    def freed() -> bool:
        try:
            server.answer(requests[0].caller, ANSWER)
        except RosError:
            return True
        return False

    eventually(freed)
    eventually(lambda: not rclpy_node.count_services("/set"))  # else the client may call the old one
    again = ours.serve("/set", SET, "", requests.extend)
    client = rclpy_node.create_client(SetBool, "/set")
    assert client.wait_for_service(60)
    future = client.call_async(SetBool.Request())
    eventually(lambda: len(requests) == 2)
    again.answer(requests[1].caller, ANSWER)
    executor = SingleThreadedExecutor(context=rclpy_node.context)
    executor.add_node(rclpy_node)
    executor.spin_until_future_complete(future, 60)
    assert future.done()
    assert not failures
