"""Services, ours at one end and stock rclpy's at the other: calls both ways, carried raw or by rclpy."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import pytest
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import SetBool
from tests.support.waiting import eventually
from type_description_interfaces.srv import GetTypeDescription

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from rsb_bridge.ros.node import RosNode

PLAN = "nav_msgs/srv/GetPlan"
SET = "std_srvs/srv/SetBool"
DESCRIBE = "type_description_interfaces/srv/GetTypeDescription"
ANSWER = serialize_message(SetBool.Response())


pytestmark = pytest.mark.usefixtures("way")


class Requests(list[Any]):
    """A sink that keeps requests, or answers them at once."""

    def __init__(self) -> None:
        super().__init__()
        self.respond: Callable[[Any], None] | None = None

    def __call__(self, batch: Any) -> None:
        self.extend(batch)
        if self.respond is not None:
            for request in batch:
                self.respond(request)


def plan(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
    response.plan.header.frame_id = request.start.header.frame_id + "!"
    response.plan.poses = [request.start, request.goal]
    return response


def test_a_stock_node_answers_our_calls(open_node: Callable[..., RosNode], stock: Node) -> None:
    ours = open_node()
    stock.create_service(GetPlan, "/plan", plan)
    [server] = eventually(lambda: [each for each in ours.servers("/plan") if each.node])
    assert (server.node, server.type_name) == ("/stock", PLAN)
    assert server.type_hash == ours.installed_service_hash(PLAN)
    responses: list[Any] = []
    client = ours.call_service("/plan", PLAN, server.type_hash, responses.extend)
    eventually(lambda: client.ready)
    numbers = {}
    for number in range(20):
        request = GetPlan.Request()
        request.start.header.frame_id = f"frame {number}"
        numbers[client.call(serialize_message(request))] = f"frame {number}!"
        eventually(lambda number=number: len(responses) > number)
    answers = {each.number: deserialize_message(each.payload, GetPlan.Response) for each in responses}
    assert {number: each.plan.header.frame_id for number, each in answers.items()} == numbers


def test_we_answer_a_stock_nodes_calls(open_node: Callable[..., RosNode], stock: Node) -> None:
    ours = open_node()
    requests = Requests()
    server = ours.serve("/set", SET, "", requests)
    client = stock.create_client(SetBool, "/set")
    assert client.wait_for_service(60)
    [caller] = eventually(lambda: [each for each in ours.callers("/set") if each.node])
    assert (caller.node, caller.type_name) == ("/stock", SET)
    assert caller.type_hash == ours.installed_service_hash(SET)
    futures = [client.call_async(SetBool.Request(data=bool(number % 2))) for number in range(5)]
    eventually(lambda: len(requests) == 5)
    for request in reversed(requests):
        asked = deserialize_message(request.payload, SetBool.Request)
        server.answer(request.caller, serialize_message(SetBool.Response(success=asked.data, message="é")))
    eventually(lambda: all(each.done() for each in futures))
    assert [each.result().success for each in futures] == [False, True, False, True, False]
    assert {each.result().message for each in futures} == {"é"}


def test_answer_behind_another_clients_is_taken(open_node: Callable[..., RosNode]) -> None:
    """DDS gives each client the answers of all, as those to a bridge that was killed; both come before it looks."""
    provider, caller, another = open_node(name="provider"), open_node(name="caller"), open_node(name="another")
    requests, answers, others = Requests(), list[Any](), list[Any]()
    is_held, may_look = threading.Event(), threading.Event()

    def hold(_: object) -> None:
        is_held.set()
        may_look.wait(180)

    server = provider.serve("/set", SET, "", requests)
    holding = provider.serve("/hold", SET, "", lambda batch: holding.answer(batch[0].caller, ANSWER))
    holder = caller.call_service("/hold", SET, "", hold)
    ours, theirs = (
        each.call_service("/set", SET, "", to.extend) for each, to in ((caller, answers), (another, others))
    )
    eventually(lambda: holder.ready and ours.ready and theirs.ready)
    for client in (theirs, ours, theirs):
        before = len(requests)
        client.call(serialize_message(SetBool.Request()))
        eventually(lambda before=before: len(requests) > before)
    holder.call(serialize_message(SetBool.Request()))
    assert is_held.wait(180)
    for request in requests:
        server.answer(request.caller, ANSWER)
    eventually(lambda: len(others) == 2, what="the answers have come")
    may_look.set()
    eventually(lambda: answers, what="our answer")


def test_description_behind_another_clients_is_taken(open_node: Callable[..., RosNode]) -> None:
    """Another client's answer comes before each of ours."""
    provider, caller, another = open_node(name="provider"), open_node(name="caller"), open_node(name="another")
    odd = "odd_msgs/msg/Odd"
    description = GetTypeDescription.Response(successful=True)
    description.type_description.type_description.type_name = odd
    held, others = list[Any](), list[Any]()

    def hold_theirs(batch: Any) -> None:
        for request in batch:
            held.append(request)
            if deserialize_message(request.payload, GetTypeDescription.Request).type_name == odd:
                for each in held:
                    server.answer(each.caller, serialize_message(description))
                held.clear()

    server = provider.serve("/described/get_type_description", DESCRIBE, "", hold_theirs)
    theirs = another.call_service("/described/get_type_description", DESCRIBE, "", others.extend)
    eventually(lambda: theirs.ready)

    def ask() -> str | None:
        theirs.call(serialize_message(GetTypeDescription.Request()))
        eventually(lambda: held)
        return caller.ask_description("/described", odd, "", lambda: True)

    assert odd in eventually(ask, what="our description")
    eventually(lambda: others, what="theirs")


def test_invalid_messages_of_peer_are_refused_or_unread(
    open_node: Callable[..., RosNode], stock: Node, way: str
) -> None:
    """Nothing but this call comes to harm: those after it are answered."""
    ours = open_node()
    taken: list[Any] = []

    def set_it(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        taken.append(request.data)
        return response

    stock.create_service(SetBool, "/set", set_it)
    stock.create_service(GetPlan, "/plan", plan)
    requests = Requests()
    server = ours.serve("/mine", SET, "", requests)
    caller = stock.create_client(SetBool, "/mine")
    assert caller.wait_for_service(60)
    responses: list[Any] = []
    setting, planning = (
        ours.call_service(name, kind, "", responses.extend) for name, kind in (("/set", SET), ("/plan", PLAN))
    )
    eventually(lambda: setting.ready and planning.ready)
    for payload in (b"", b"\0\1\0"):
        with pytest.raises(RosError):
            setting.call(payload)
    endless = serialize_message(GetPlan.Request())[:12] + b"\xff\xff\xff\x7f" + bytes(40)
    with pytest.raises(RosError) if way == "typed" else nullcontext():
        planning.call(endless)  # raw: the server finds out
    future = caller.call_async(SetBool.Request())
    eventually(lambda: requests)
    for broken in (b"", b"\0\1"):
        with pytest.raises(RosError):
            server.answer(requests[0].caller, broken)
    server.answer(requests[0].caller, serialize_message(SetBool.Response()))
    eventually(future.done)
    number = setting.call(serialize_message(SetBool.Request(data=True)))
    eventually(lambda: any(each.number == number for each in responses))
    assert taken == [True]
