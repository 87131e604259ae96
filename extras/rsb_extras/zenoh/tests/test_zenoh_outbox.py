"""Sending on the loop and by a thread, with a session that a test can block."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, cast

import pytest
from tests.support.virtual_time import VirtualLoop, virtual_loop
from tests.support.waiting import eventually

from rsb_extras.zenoh.outbox import AT_ONCE, IN_FLIGHT, LINK_RANK, OWN_COST, SampleOutbox
from rsb_extras.zenoh.sample_header import Header, SampleKind

zenoh = pytest.importorskip("zenoh")


HERE = threading.get_ident


class FakeSession:
    """Takes samples.

    Attributes:
        put_by: of each sample: its payload, its priority, and the thread that brought it.
        open: while it is not set, samples of these priorities are held back.
    """

    def __init__(self) -> None:
        self.put_by: list[tuple[bytes, Any, int]] = []
        self.held_back: list[Any] = []
        self.open = threading.Event()
        self.closed = False

    def put(self, key: str, payload: bytes, *, priority: Any, congestion_control: Any, **_: Any) -> None:
        if self.closed:
            raise zenoh.ZError("closed")
        if priority in self.held_back and congestion_control == zenoh.CongestionControl.BLOCK:
            self.open.wait()
        self.put_by.append((payload, priority, threading.get_ident()))

    def payloads(self) -> list[bytes]:
        return [payload for payload, _, _ in self.put_by]


class Case:
    """An outbox on a virtual loop."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.loop = loop
        self.session = FakeSession()
        self.outbox = SampleOutbox(cast("Any", self.session), loop)

    def put(self, payload: bytes, rank: int = 2, key: str = "k") -> None:
        self.outbox.put(key, payload, Header(SampleKind.DATA, rank, 0))


@pytest.fixture
def case() -> Iterator[Case]:
    with virtual_loop() as loop:
        made = Case(loop)
        yield made
        made.session.open.set()
        made.outbox.close()
        eventually(lambda: all(each.name != "zenoh-send" for each in threading.enumerate()), what="no thread left")


def test_little_is_sent_at_once_and_without_thread(case: Case) -> None:
    for number in range(100):
        case.put(bytes([number]))
    assert case.session.payloads() == [bytes([number]) for number in range(100)]
    assert {thread for _, _, thread in case.session.put_by} == {HERE()}


def test_order_is_kept_between_both_ways(case: Case) -> None:
    sent = [str(number).encode() * (20_000 if number % 7 == 0 else 10) for number in range(300)]
    for each in sent:
        case.put(each)
        case.loop.jump(0.02)
    eventually(lambda: len(case.session.put_by) == len(sent))
    assert case.session.payloads() == sent
    assert len({thread for _, _, thread in case.session.put_by}) == 2


def test_immediate_sends_fit_zenohs_queue(case: Case) -> None:
    """16 batches of 64 kB, half full at the worst, in the 5 s in which a router that takes nothing is found out."""
    for _ in range(600):
        case.put(bytes(40_000))
        case.put(bytes(100))
        case.loop.jump(0.005)
    eventually(lambda: len(case.session.put_by) == 1200)
    at_once = sum(len(payload) for payload, _, thread in case.session.put_by if thread == HERE())
    assert 0 < at_once <= 16 * 32 * 1024


def test_soon_arrivals_are_sent_at_any_rate(case: Case) -> None:
    """The other side reports it each time: a hundred times the amount that goes at once without reports."""
    for _ in range(1000):
        case.put(bytes(10_000))
        case.outbox.arrived(2, 10_000 + OWN_COST)
        case.loop.jump(0.001)
    assert {thread for _, _, thread in case.session.put_by} == {HERE()}


def test_what_nobody_reports_is_not_sent_at_once(case: Case) -> None:
    """Windows, ends, and data of which more is in flight than fits Zenoh's queue."""
    for _ in range(100):
        case.put(bytes(10_000))
    for _ in range(1000):
        case.outbox.put("k", bytes(1000), Header(SampleKind.WINDOW, 2, 0))
    eventually(lambda: len(case.session.put_by) == 1100)
    at_once = sum(len(payload) for payload, _, thread in case.session.put_by if thread == HERE())
    assert IN_FLIGHT < at_once <= 16 * 32 * 1024


def test_false_reports_hold_the_loop_up_once(case: Case) -> None:
    """A peer that reports what the network has not taken: a call waits though hardly anything is in flight."""
    take = case.session.put

    def put(*args: Any, **settings: Any) -> None:
        take(*args, **settings)
        if threading.get_ident() == HERE():
            case.loop.jump(1.0)

    def threads(count: int) -> list[bool]:
        case.session.put_by.clear()
        for _ in range(count):
            case.put(bytes(6 * AT_ONCE))
            case.outbox.arrived(2, 6 * AT_ONCE + OWN_COST)
        eventually(lambda: len(case.session.put_by) == count)
        return [thread != HERE() for _, _, thread in case.session.put_by]

    case.put(bytes(4 * AT_ONCE))
    case.outbox.arrived(2, 4 * AT_ONCE + OWN_COST)
    case.session.put = put  # type: ignore[method-assign]
    case.put(b"first")
    case.outbox.arrived(2, 5 + OWN_COST)
    for _ in range(8):
        case.loop.jump(60)
        assert all(threads(3))


def test_sender_that_is_held_back_is_thread(case: Case) -> None:
    case.put(bytes(5 * AT_ONCE))
    eventually(lambda: case.session.put_by)
    case.session.held_back.append(zenoh.Priority.DATA)
    for number in range(50):
        case.put(bytes([number]) * AT_ONCE)  # returns, though nothing is taken
    assert case.outbox.waiting("k", 2) >= 49 * AT_ONCE
    case.session.open.set()
    eventually(lambda: len(case.session.put_by) == 51)
    assert case.session.payloads()[1:] == [bytes([number]) * AT_ONCE for number in range(50)]
    assert case.outbox.waiting("k", 2) == 0


def test_a_rank_does_not_wait_for_another(case: Case) -> None:
    """A link's own messages go, while a map waits."""
    case.session.held_back.append(zenoh.Priority.DATA)
    for _ in range(3):
        case.put(bytes(6 * AT_ONCE))
    case.put(b"alive", LINK_RANK)
    assert case.session.payloads() == [b"alive"]


def test_datagrams_fill_no_queue_of_a_stream(case: Case) -> None:
    case.outbox.drop("k", b"datagram")
    for rank in range(5):
        case.put(b"stream", rank)
    (_, of_datagrams, _), *streams = case.session.put_by
    assert of_datagrams not in [priority for _, priority, _ in streams]


def test_after_call_that_took_long_thread_sends(case: Case) -> None:
    """The network is slow: the loop waits for it one time at most."""
    slow = case.session.put

    def put(*args: Any, **settings: Any) -> None:
        slow(*args, **settings)
        case.loop.jump(1.0)

    case.session.put = put  # type: ignore[method-assign]
    case.put(b"first")
    case.session.put = slow  # type: ignore[method-assign]
    case.put(b"second")
    eventually(lambda: len(case.session.put_by) == 2)
    assert [thread == HERE() for _, _, thread in case.session.put_by] == [True, False]

    def is_sent_here() -> bool:
        case.loop.jump(60)  # each time: a call of the thread that still runs takes as long
        case.put(b"third")
        return case.session.put_by[-1][2] == HERE()

    eventually(is_sent_here, what="the thread has nothing left")


def test_samples_of_nothing_are_counted_as_nothing(case: Case) -> None:
    case.session.held_back.append(zenoh.Priority.DATA)
    case.put(bytes(6 * AT_ONCE))
    for _ in range(3):
        case.put(b"")
    case.session.open.set()
    eventually(lambda: len(case.session.put_by) == 4)
    assert case.outbox.waiting("k", 2) == 0


def test_a_closed_network_takes_no_harm(case: Case) -> None:
    case.session.closed = True
    case.put(b"x")
    case.outbox.drop("k", b"x")
    case.put(bytes(6 * AT_ONCE))
    case.outbox.close()
    case.put(bytes(6 * AT_ONCE))
    assert case.session.put_by == []
