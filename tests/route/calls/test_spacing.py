"""Feedback and answers that a link delivers at once after a gap, and clients that keep ten."""

from __future__ import annotations

import asyncio
import itertools
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.goals import cancel_request, cancel_response, goal, goal_request, result_response
from tests.support.offline import half_of

from rsb_bridge.model.calls import CANCEL_GOAL, FEEDBACK, GET_RESULT
from rsb_bridge.model.session import Topic
from rsb_bridge.route.calls.asked_calls import CallerCall
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.wire.framing import Message

_MS = 1_000_000


class Client:
    """A client of an action: what it gets, and when (s)."""

    def __init__(self, make_context: Callable[..., Context], loop: VirtualLoop, **spec: Any) -> None:
        self.got: list[tuple[float, int]] = []
        self.loop = loop
        topic = Topic("/dock", "receive", **{"kind": "action", **spec})
        self.half = half_of(Caller, make_context(check_messages=False), topic, here=False)
        publisher: Any = SimpleNamespace(publish=lambda content: self.got.append((loop.time(), content[-1])))
        self.half.offer.lanes.topics[FEEDBACK] = publisher

    def asks(self, lane: int = CANCEL_GOAL) -> None:
        server: Any = SimpleNamespace(answer=lambda *_: self.got.append((self.loop.time(), -1)))
        self.half.under_way.pending.begin(CallerCall(lane, 1, 0.0, server, b"caller"), None)

    def asked_at(self, times: Iterable[float]) -> list[CallFrame]:
        """Have calls of a service asked at these times (s), and return the answers to them."""
        pending, took = self.half.under_way.pending, 1_000_000
        for at in times:
            server: Any = SimpleNamespace(answer=lambda *_: self.got.append((self.loop.time(), -1)))
            pending.begin(CallerCall(0, 1, at, server, b"caller"), None)
        return [CallFrame(What.ANSWER, 0, number, took, b"\0\1\0\0") for number, _ in pending.items()]

    def times(self) -> list[float]:
        return [at for at, _ in self.got]


def feedback(number: int, at_ms: float) -> Message:
    content = b"\0\1\0\0" + goal(1) + bytes((number,))
    return CallFrame(What.MESSAGE, FEEDBACK, 0, 0, content).pack(), int(at_ms * _MS), 0


def test_feedback_that_comes_at_once_is_kept_apart(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    client = Client(make_context, loop)
    client.asks()
    answer = CallFrame(What.ANSWER, CANCEL_GOAL, 1, 0, cancel_response(goal(1))).pack(), 0, 0
    client.half.deliver([*(feedback(number, 1000 + 150 * number) for number in range(50)), answer])
    client.half.deliver([feedback(50, 1000 + 150 * 50)])
    loop.run_until_complete(asyncio.sleep(5.0))
    assert [number for _, number in client.got] == [*range(50), -1, 50], "later frames wait, too"
    times = client.times()
    assert all(later - earlier > 0.049 for earlier, later in itertools.pairwise(times[1:50]))
    assert times[-1] - times[0] < 2.6


def test_result_keeps_its_distance_from_feedback(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """A client that finds both in one look may handle the result first, and then ignores the feedback."""
    client = Client(make_context, loop)
    client.asks(GET_RESULT)
    result = CallFrame(What.ANSWER, GET_RESULT, 1, 0, result_response("succeeded")).pack(), 1280 * _MS, 0
    client.half.deliver([*(feedback(number, 1000 + 100 * number) for number in range(3)), result])
    loop.run_until_complete(asyncio.sleep(1.0))
    *_, (fed, number), (answered, last) = client.got
    assert (number, last) == (2, -1)
    assert 0.039 < answered - fed < 0.042


def test_requests_for_results_hold_up_no_cancel(make_context: Callable[..., Context]) -> None:
    """After a gap they come at once, and a cancel may stop a robot."""
    half = half_of(Provider, make_context(), Topic("/dock", "receive", kind="action"))
    requests = [
        (CallFrame(What.CALL, GET_RESULT, number, 0, goal_request(goal(number))).pack(), number * 100 * _MS, 0)
        for number in range(1, 11)
    ]
    cancel = CallFrame(What.CALL, CANCEL_GOAL, 11, 0, cancel_request(goal(1))).pack(), 1100 * _MS, 0
    half.deliver([*requests, cancel])
    assert half.flow.calls.asked == 11


def test_feedback_in_time_is_not_delayed(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """At 1 kHz, also if messages come in pairs."""
    client = Client(make_context, loop)
    for number in range(0, 100, 2):
        began = loop.time()
        client.half.deliver([feedback(number, 1000 + number), feedback(number + 1, 1000 + number + 1)])
        loop.run_until_complete(asyncio.sleep(0.002))
        assert len(client.got) == number + 2
        assert client.times()[-1] - began < 0.001


@pytest.mark.parametrize("rate", [10.0, 100.0])
@pytest.mark.parametrize("held", ["requests", "answers"])
def test_answers_of_a_gap_are_kept_apart(
    held: str, rate: float, make_context: Callable[..., Context], loop: VirtualLoop
) -> None:
    """A link that held up requests has its node answer them at once."""
    gap = 6.0
    client = Client(make_context, loop, kind="service")
    answers = client.asked_at(loop.time() + number / rate for number in range(int(gap * rate)))
    loop.run_until_complete(asyncio.sleep(gap))
    stamps = [int(number / rate * 1e9) if held == "answers" else int(gap * 1e9) for number in range(len(answers))]
    client.half.deliver([(each.pack(), stamp, 0) for each, stamp in zip(answers, stamps, strict=True)])
    loop.run_until_complete(asyncio.sleep(gap))
    times = client.times()
    assert len(times) == len(answers)
    assert all(times[last + 10] - times[last] > 0.8 * 5 / rate for last in range(len(times) - 10))
    assert times[-1] - times[0] < 0.55 * gap


@pytest.mark.parametrize("timeout", [2.0, 30.0])
def test_answers_of_long_gap_catch_up(timeout: float, make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    client = Client(make_context, loop, kind="service", timeout=timeout)
    answers = client.asked_at(loop.time() + number / 10 for number in range(600))
    loop.run_until_complete(asyncio.sleep(60.0))
    client.half.deliver([(each.pack(), 0, 0) for each in answers])
    loop.run_until_complete(asyncio.sleep(timeout / 2))
    assert len(client.got) == 600


def test_answers_without_a_gap_come_at_once(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """Their node gave them at once."""
    client, began = Client(make_context, loop, kind="service"), loop.time()
    answers = client.asked_at(began + number for number in range(60))
    loop.run_until_complete(asyncio.sleep(60.0))
    took = [int((60 - number) * 1e9) for number in range(60)]
    client.half.deliver([(each._replace(took=its).pack(), 0, 0) for each, its in zip(answers, took, strict=True)])
    assert len(client.got) == 60


def test_long_answers_of_a_gap_do_not_wait(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """More bytes than may wait would end the opening, and lose all calls."""
    client = Client(make_context, loop, kind="service")
    answers = client.asked_at(loop.time() + number / 10 for number in range(60))
    loop.run_until_complete(asyncio.sleep(6.0))
    content = bytes(1 << 20)
    client.half.deliver([(each._replace(content=content).pack(), 0, 0) for each in answers])
    assert len(client.got) == 60 - 15
    loop.run_until_complete(asyncio.sleep(3.0))
    assert len(client.got) == 60


def test_answers_in_any_order_take_no_longer(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    client = Client(make_context, loop, kind="service")
    answers = client.asked_at(loop.time() + number / 100 for number in range(600))
    loop.run_until_complete(asyncio.sleep(6.0))
    Random(1).shuffle(answers)
    client.half.deliver([(each.pack(), 0, 0) for each in answers])
    loop.run_until_complete(asyncio.sleep(3.1))
    assert len(client.got) == 600
