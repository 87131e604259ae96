"""Calls that wait for their answers, and are given up in time."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING
from unittest.mock import Mock, patch

import pytest
from tests.support.held import held_by
from tests.support.inside import timer_of

from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.peer_budget import CallBudget

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop


class Held:
    """Calls in flight, and calls that were given up."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.loop = loop
        self.budget = CallBudget(0.0)
        self.expired: list[tuple[int, float]] = []
        self.ended: list[int] = []
        self.calls: PendingCalls[PendingCall] = PendingCalls(loop, self.budget, self._expired, self.ended.append)

    def begin(self, number: int, timeout: float | None, size: int = 10) -> None:
        assert self.budget.take(size, self.loop.time()) is None
        self.calls.add(number, PendingCall(0, size, self.loop.time()), timeout)

    def pass_time(self, seconds: float) -> None:
        self.loop.run_until_complete(asyncio.sleep(seconds))

    def _expired(self, number: int, call: PendingCall) -> None:
        assert number not in self.calls
        self.expired.append((number, self.loop.time()))


@pytest.fixture
def held(loop: VirtualLoop) -> Held:
    return Held(loop)


def test_limit_counts_from_when_it_is_set_first(held: Held) -> None:
    held.begin(1, None)
    held.begin(2, 30.0)
    held.pass_time(20.0)
    for number in (1, 2, 3):
        held.calls.limit(number, 5.0)
    held.pass_time(3.0)
    held.calls.limit(1, 5.0)
    held.calls.suspend()
    held.pass_time(100.0)
    held.calls.resume()
    held.pass_time(20.0)
    assert [(number, round(at, 3)) for number, at in held.expired] == [(1, 125.0), (2, 130.0)]


def test_each_is_given_up_after_its_own_time(held: Held) -> None:
    held.begin(1, 5.0)
    held.begin(2, 2.0)
    held.begin(3, None)
    held.begin(4, 3.0)
    assert held.calls.end(4) is not None
    held.pass_time(10.0)
    assert [(number, round(at, 3)) for number, at in held.expired] == [(2, 2.0), (1, 5.0)]
    assert [number for number, _ in held.calls.items()] == [3]
    assert held.ended == [4, 2, 1], "each is reported once"
    assert held.budget.held == (1, 10)


def test_a_call_ends_once(held: Held) -> None:
    held.begin(1, 5.0)
    assert held.calls.end(1) is not None
    assert held.calls.end(1) is None
    held.pass_time(10.0)
    assert not held.expired
    assert held.budget.held == (0, 0)


def test_no_timer_remains_without_calls(held: Held) -> None:
    held.begin(1, 1000.0)
    held.begin(2, None)
    assert [number for number, _ in held.calls.clear()] == [1, 2]
    assert held.ended == [1, 2]
    assert held.budget.held == (0, 0)
    assert not timer_of(held.calls)
    assert not held_by(held.calls)


def test_calls_one_after_another_set_one_timer(held: Held) -> None:
    """To set a timer wakes the I/O loop, and to cancel it costs as much as to send the call."""
    set_ = Mock(wraps=held.loop.call_at)
    with patch.object(held.loop, "call_at", set_):
        for number in range(1, 101):
            held.begin(number, 10.0)
            held.calls.end(number)
    assert set_.call_count == 1


def test_call_with_reused_number_has_own_time(held: Held) -> None:
    """In the route's next opening, numbers begin again."""
    held.begin(1, 5.0)
    held.calls.clear()
    held.pass_time(3.0)
    held.begin(1, 5.0)
    held.pass_time(10.0)
    assert [(number, round(at, 3)) for number, at in held.expired] == [(1, 8.0)]


def test_timer_of_ended_call_expires_later_ones(held: Held) -> None:
    held.begin(1, 5.0)
    held.pass_time(1.0)
    held.begin(2, 5.0)
    held.calls.end(1)
    held.pass_time(10.0)
    assert [(number, round(at, 3)) for number, at in held.expired] == [(2, 6.0)]


def test_an_answer_may_hold_more_than_its_request(held: Held) -> None:
    held.begin(1, 5.0, size=10)
    call = held.calls.get(1)
    assert call is not None
    assert held.calls.resize(call, 500)
    assert held.budget.held == (1, 500)
    assert not held.calls.resize(call, 1 << 40)
    held.calls.end(1)
    assert held.budget.held == (0, 0)


def test_memory_of_ended_calls_does_not_grow(held: Held) -> None:
    """However long the timeout is, and however many calls are over before it."""
    random = Random(1)
    waiting: list[int] = []
    for number in range(1, 3_001):
        held.begin(number, 3600.0)
        waiting.append(number)
        if len(waiting) > 100:
            held.calls.end(waiting.pop(random.randrange(len(waiting))))
        held.pass_time(0.001)
    assert len(held.calls) == 100
    assert held_by(held.calls) <= 100 + 2 * 101 + 64
