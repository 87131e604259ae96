"""The limits of one link's calls, in bytes and in calls a second."""

from __future__ import annotations

import pytest

from rsb_bridge.model.calls import Refused
from rsb_bridge.route.peer_budget import PEERS_SHARE, CallBudget, CallLimits

_LIMITS = CallLimits(under_way=3, bytes_under_way=1000, a_second=10.0)


@pytest.fixture
def budget() -> CallBudget:
    return CallBudget(0.0, _LIMITS)


def test_calls_under_way(budget: CallBudget) -> None:
    assert [budget.take(1, 0.0) for _ in range(4)] == [None, None, None, Refused.CALLS_UNDER_WAY]
    budget.give(1)
    assert budget.take(1, 0.0) is None
    assert budget.held == (3, 3)


def test_bytes_under_way_of_requests_then_answers(budget: CallBudget) -> None:
    assert budget.take(600, 0.0) is None
    assert budget.take(401, 0.0) is Refused.BYTES_UNDER_WAY
    assert budget.held == (1, 600)
    assert budget.change(600, 1000)
    assert not budget.change(1000, 1001)
    budget.give(1000)
    assert budget.held == (0, 0)


def test_calls_a_second(budget: CallBudget) -> None:
    taken = 0
    for _ in range(15):
        if budget.take(1, 0.0) is None:
            taken += 1
            budget.give(1)
    assert taken == 10
    assert budget.take(1, 0.05) is Refused.TOO_FAST
    assert budget.take(1, 0.1) is None


def test_expired_calls_count_while_dds_holds_them(budget: CallBudget) -> None:
    """A server that is stopped takes nothing; else a short timeout would let a peer fill this side's memory."""
    assert budget.take(700, 0.0) is None
    budget.give(700)
    budget.linger(700, 0.5)
    budget.linger(100, 1.0)
    assert budget.held == (0, 0)
    assert budget.take(201, 2.0) is Refused.BYTES_UNDER_WAY
    assert budget.take(200, 2.0) is None
    budget.give(200)
    assert budget.take(1000, 23.0) is None


def test_the_peer_may_have_a_little_more(budget: CallBudget) -> None:
    theirs = CallBudget(0.0, _LIMITS, PEERS_SHARE)
    assert budget.take(1001, 0.0) is Refused.BYTES_UNDER_WAY
    assert theirs.take(1001, 0.0) is None
