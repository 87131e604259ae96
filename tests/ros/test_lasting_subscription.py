"""When a subscription that failed is opened again, on virtual time."""

from __future__ import annotations

import asyncio
from itertools import pairwise

import pytest
from tests.support.virtual_time import virtual_loop

from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.ros_interface import Liveliness, OnFailure, RosError


class _Opened:
    liveliness = Liveliness(alive=1)
    matched = 1
    refuses = False

    def __init__(self, on_failure: OnFailure) -> None:
        self.fail = on_failure
        self.closed = False

    def close(self) -> None:
        self.closed = True


def test_it_is_opened_again_with_growing_delays() -> None:
    opened, changes = list[_Opened](), list[tuple[float, str]]()
    refused = False

    def subscribe(on_failure: OnFailure) -> _Opened:
        if refused:
            raise RosError("refused")
        opened.append(_Opened(on_failure))
        return opened[-1]

    with virtual_loop() as loop:
        subscription = LastingSubscription(loop, subscribe, lambda: changes.append((loop.time(), subscription.failure)))
        for _ in range(8):
            opened[-1].fail(RosError("broken"))
            loop.run_until_complete(asyncio.sleep(40))
        assert [failure for _, failure in changes] == ["broken", ""] * 8
        delays = [after - before for (before, _), (after, _) in pairwise(changes)][::2]
        assert delays == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
        assert [each.closed for each in opened] == [True] * 8 + [False]

        loop.run_until_complete(asyncio.sleep(60))
        opened[-1].fail(RosError("broken"))
        opened[-1].fail(RosError("it is closed already"))
        refused = True
        began = loop.time()
        loop.run_until_complete(asyncio.sleep(0.6))
        assert changes[-2:] == [(began, "broken"), (began + 0.5, "refused")]
        subscription.close()
        count = len(changes)
        loop.run_until_complete(asyncio.sleep(100))
        assert len(changes) == count


def test_early_failure_is_opened_again() -> None:
    """The ROS thread takes from it as soon as it is there."""
    opened = list[_Opened]()

    def subscribe(on_failure: OnFailure) -> _Opened:
        if not opened:
            on_failure(RosError("broken"))
        opened.append(_Opened(on_failure))
        return opened[-1]

    with virtual_loop() as loop:
        LastingSubscription(loop, subscribe, lambda: None)
        loop.run_until_complete(asyncio.sleep(1))
    assert [each.closed for each in opened] == [True, False]


def test_a_first_attempt_that_fails_is_the_callers() -> None:
    def subscribe(_: OnFailure) -> _Opened:
        raise RosError("no")

    with virtual_loop() as loop, pytest.raises(RosError):
        LastingSubscription(loop, subscribe, lambda: None)
