"""The goals of a link's callers are cancelled once their arming ends, if a session wants that."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.calls.goal_cancels_helpers import Client
from tests.route.calls.held_helpers import providing
from tests.support.goals import cancel_request, cancel_response, goal, goal_response, statuses
from tests.support.inside import paced

from rsb_bridge.model.calls import CANCEL_GOAL, GET_RESULT, SEND_GOAL, STATUS
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import Demands, sources_of_names
from rsb_bridge.model.session import ArmedName
from rsb_bridge.ros.ros_interface import Response
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.calls.action_goals import ProviderGoals
from rsb_bridge.route.calls.paced_client import PacedClient

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.calls.provider import Provider


@pytest.fixture
def make_half(make_context: Callable[..., Context]) -> Callable[..., Provider]:
    """Makes an armed action, whose server has goals 1 and 3 of this link, of which 3 is not answered, and another 2."""

    def make(on_end: str | None = "cancel", there: str = "") -> Provider:
        context = make_context(armed=(ArmedName("/dock", on_end=on_end),))
        half = providing(context, arm=True)
        half.route.arming.own = context.demands.read().of("action", "/dock") or half.route.arming.own
        half.route.arming.peer_on_end = there
        lanes = SEND_GOAL, CANCEL_GOAL, GET_RESULT
        for lane in lanes:
            call_with(Client(), half, lane)
        for number in (1, 3):
            goals_of(half).goals.asked(goal(number))
            goals_of(half).undecided[number] = goal(number)
        half.route.arming.arm_for_peer("anna", context.now())
        accept(half, 1)
        goals_of(half).goals.message(STATUS, statuses((goal(1), "executing"), (goal(2), "executing")))
        return half

    return make


def goals_of(half: Provider) -> ProviderGoals:
    assert isinstance(half.kind, ProviderGoals)
    return half.kind


def call_with(client: Client, half: Provider, lane: int) -> None:
    """Have a half call a service with this client from now on."""
    service: Any = SimpleNamespace(lane=lane, client=PacedClient(client, half.route.context.loop), close=lambda: None)
    half.under_way.clients.services[lane] = service


def respond(half: Provider, lane: int, payload: bytes, number: int) -> None:
    half.under_way.responded(half.under_way.clients.services[lane], [Response(payload, number, 0)])


def accept(half: Provider, number: int) -> None:
    respond(half, SEND_GOAL, goal_response(True), number)


def client_of(half: Provider) -> Client:
    client: Client = paced(half.under_way.clients.services[CANCEL_GOAL].client)
    return client


def cancels(half: Provider) -> list[bytes]:
    return list(client_of(half).calls)


def test_end_of_arming_cancels_this_links_goals(make_half: Callable[..., Provider]) -> None:
    half = make_half()
    assert not cancels(half)
    half.route.disarm(Disarmed.DEADMAN)
    assert set(cancels(half)) == {cancel_request(goal(1)), cancel_request(goal(3))}
    late = half.flow.calls.late
    respond(half, CANCEL_GOAL, cancel_response(goal(1)), 1)
    assert half.flow.calls.late == late, "it is no answer to a call of the other side's"


@pytest.mark.parametrize("armed_again", [False, True])
def test_goal_that_is_accepted_later_is_cancelled_then(armed_again: bool, make_half: Callable[..., Provider]) -> None:
    """Nor does it run by the arming of the next operator."""
    half = make_half()
    half.route.disarm(Disarmed.OPERATOR)
    if armed_again:
        half.route.arming.opened(required=True, deadman=0.0)
        half.route.arming.arm_for_peer("bert", half.route.context.now())
    before = len(cancels(half))
    accept(half, 3)
    assert cancels(half)[before:] == [cancel_request(goal(3))]


@pytest.mark.parametrize(
    ("on_end", "there", "cancelled"),
    [
        (None, "", 0),
        ("none", "", 0),
        ("none", "cancel", 2),
        (None, "cancel", 2),
        ("cancel", "none", 2),
        ("zero", "", 0),
    ],
)
def test_the_more_careful_session_counts(
    on_end: str | None, there: str, cancelled: int, make_half: Callable[..., Provider]
) -> None:
    half = make_half(on_end, there)
    assert half.facts.on_end == ("cancel" if cancelled else "none")
    half.route.disarm(Disarmed.LINK_LOST)
    assert len(cancels(half)) == cancelled


def test_line_of_kind_is_for_fitting_goals() -> None:
    demands = Demands(sources_of_names((ArmedName("/**", on_end="cancel"), ArmedName("/**", on_end="zero"))))
    found = {kind: demands.of(kind, "/dock") for kind in ("topic", "action", "service", "parameters")}
    assert {kind: each and each.on_end for kind, each in found.items()} == {
        "topic": "zero", "action": "cancel", "service": "", "parameters": ""
    }  # fmt: skip


def reported(half: Provider) -> int:
    return sum(each.code == EventCode.ROUTE_CALL_FAILED for each in half.route.context.events.after(0))


@pytest.mark.parametrize(
    ("answer", "goes_on"),
    [
        (cancel_response(goal(1)), False),
        (cancel_response(goal(1), order=">"), False),
        (cancel_response(), True),
        (cancel_response(order=">"), True),
        (bytes((0, 1, *bytes(10))), True),  # of a server that rclpy makes: no error, and no goal
        (bytes((0, 1, 0, 0, 2, *bytes(7))), False),  # an unknown goal
        (bytes((0, 1, 0, 0, 3, *bytes(7))), False),  # one that is over
        (b"", True),
        (None, True),
    ],
)
def test_goal_that_is_not_cancelled_is_reported(
    answer: bytes | None, goes_on: bool, make_half: Callable[..., Provider], loop: VirtualLoop
) -> None:
    half = make_half()
    half.route.disarm(Disarmed.LINK_LOST)
    for number, _ in enumerate(cancels(half), 1):
        if answer is not None:
            respond(half, CANCEL_GOAL, answer, number)
    for _ in range(10):
        loop.jump(1.0)
        half.route.tick()
    assert reported(half) == goes_on * len(cancels(half))


def test_a_goal_that_cannot_be_cancelled_is_reported(make_half: Callable[..., Provider]) -> None:
    for gone in (True, False):
        half = make_half()
        if gone:
            half.under_way.clients.close()
        else:
            client_of(half).ready = False
        half.route.disarm(Disarmed.LINK_LOST)
        assert reported(half) == 2


def test_another_clients_answer_is_no_answer_to_cancel(make_half: Callable[..., Provider]) -> None:
    half = make_half()
    half.route.disarm(Disarmed.LINK_LOST)
    respond(half, CANCEL_GOAL, cancel_response(goal(1)), 1)
    late = half.flow.calls.late
    respond(half, CANCEL_GOAL, cancel_response(goal(1)), 1)
    call_with(Client(), half, CANCEL_GOAL)
    respond(half, CANCEL_GOAL, cancel_response(goal(3)), 2)
    assert half.flow.calls.late == late + 2


def test_fifty_goals_are_cancelled_without_overflow(make_half: Callable[..., Provider], loop: VirtualLoop) -> None:
    """Their node keeps ten cancels that it has not read."""
    half = make_half()
    for number in range(4, 52):
        goals_of(half).goals.asked(goal(number))
    half.route.disarm(Disarmed.LINK_LOST)
    for number in range(1, 51):
        assert len(cancels(half)) == min(7 + number, 50)
        respond(half, CANCEL_GOAL, cancel_response(goal(number)), number)
    for _ in range(10):
        loop.jump(1.0)
        half.route.tick()
    assert not reported(half)
