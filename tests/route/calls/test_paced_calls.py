"""Calls that come at once, as after a gap of the link, and a node that keeps only ten requests."""

from __future__ import annotations

import asyncio
import itertools
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.route.calls.gone_helpers import LAMP, Graph, providing

from rsb_bridge.ros.ros_interface import Response
from rsb_bridge.route.calls.paced_client import PacedClient
from rsb_bridge.wire.headers import CallFrame, What

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.calls.provider import Provider


class Lamp:
    """A route that provides a service, and the requests that its node has got."""

    def __init__(self, make_context: Callable[..., Context], loop: VirtualLoop) -> None:
        ros = self._ros = Graph()
        ros.found = [LAMP]
        self._loop = loop
        self.got: list[int] = []
        self._numbers = itertools.count(1)
        self._answered = 0
        ros.client = SimpleNamespace(ready=True, call=self._call, close=lambda: None)
        self.half: Provider = providing(ros, make_context)
        self.route = self.half.route
        self.route.advance()
        loop.run_until_complete(asyncio.sleep(1.0))  # its type is loaded

    def _call(self, request: bytes) -> int:
        self.got.append(request[-1])
        return next(self._numbers)

    def ask(self, first: int, last: int) -> None:
        calls = (CallFrame(What.CALL, 0, number, 0, bytes((0, 1, 0, 0, number))) for number in range(first, last + 1))
        self.route.deliver([(each.pack(), 0, 0) for each in calls])

    def answer(self, count: int = 1) -> None:
        for _ in range(count):
            self._answered += 1
            self._ros.respond([Response(bytes(16), self._answered, 0)])
        self._loop.run_until_complete(asyncio.sleep(0))


def test_next_call_waits_for_an_answer(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    lamp = Lamp(make_context, loop)
    lamp.ask(1, 50)
    assert lamp.got == list(range(1, 9))
    for number in range(1, 51):
        assert len(lamp.got) == min(7 + number, 50)
        lamp.answer()
    assert lamp.got == list(range(1, 51))
    lamp.route.close("over")
    assert_nothing_held(lamp.route)


def test_unanswered_calls_hold_up_others_briefly(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """The node may answer only once it has all calls."""
    lamp = Lamp(make_context, loop)
    lamp.ask(1, 100)
    loop.run_until_complete(asyncio.sleep(2.4))
    assert len(lamp.got) == 100
    lamp.answer(100)
    lamp.ask(101, 150)
    assert len(lamp.got) == 108, "the next burst waits again"
    lamp.route.close("over")
    assert_nothing_held(lamp.route)


def test_waiting_calls_end_with_the_opening(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    lamp = Lamp(make_context, loop)
    lamp.ask(1, 50)
    lamp.route.close("over")
    loop.run_until_complete(asyncio.sleep(5.0))
    assert len(lamp.got) == 8
    assert_nothing_held(lamp.route)


def test_waiting_call_that_expires_never_reaches_the_node(
    make_context: Callable[..., Context], loop: VirtualLoop
) -> None:
    """The node answers a call in 0.4 s, and the callers wait for 30 s."""
    lamp = Lamp(make_context, loop)
    lamp.ask(1, 150)
    began = loop.time()
    since: list[float] = []
    while lamp.half.flow.calls.in_flight:
        loop.run_until_complete(asyncio.sleep(0.4))
        since += [loop.time() - began] * (len(lamp.got) - len(since))
        lamp.answer()
        shown = lamp.route.snapshot().calls
        assert shown is not None
        assert shown.waiting == 150 - lamp.half.flow.calls.waited - len(lamp.got)
        assert lamp.half.facts.end.at_node()[0] == len(lamp.got)
    assert 75 <= len(lamp.got) <= 84
    assert max(since) <= 30.4
    assert lamp.half.flow.calls.waited == 150 - len(lamp.got)
    lamp.route.close("over")
    assert_nothing_held(lamp.route)


class Patrol:
    """A client of `get_result` whose node reads nothing until the test lets it."""

    ready = True

    def __init__(self) -> None:
        self.asked: list[bytes] = []

    def call(self, request: bytes) -> int:
        self.asked.append(request)
        return len(self.asked)

    def close(self) -> None: ...


def test_results_wait_until_node_has_read_probe(loop: VirtualLoop) -> None:
    """A result comes when its goal is over, so that it does not show that the node has read anything."""
    node = Patrol()
    client = PacedClient(node, loop, b"probe")
    for number in range(30):
        client.in_turn(number, partial(client.call, b"%d" % number))
    read = 0
    while len(node.asked) > read:
        assert len(node.asked) - read <= 9
        read = len(node.asked)
        is_probe = node.asked[-1] == b"probe"
        assert client.answered(read) is is_probe
    assert [each for each in node.asked if each != b"probe"] == [b"%d" % number for number in range(30)]


def test_node_that_knows_no_probe_gets_all_results(loop: VirtualLoop) -> None:
    node = Patrol()
    client = PacedClient(node, loop, b"probe")
    for number in range(100):
        client.in_turn(number, partial(client.call, b"%d" % number))
    most = before = 0
    while client.waiting:
        loop.run_until_complete(asyncio.sleep(0.01))
        most, before = max(most, len(node.asked) - before), len(node.asked)
    assert most <= 9
    assert loop.time() < 10.0


def assert_nothing_held(route: Any) -> None:
    assert route.peer.budget.provided.held == (0, 0)
