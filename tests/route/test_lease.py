"""The lease of a link, between two sides; `tests/simulation/test_lease.py` has stalls, threads and networks."""

from __future__ import annotations

import pytest

from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.ros.ros_thread import LONGEST_WAIT, RosTurns
from rsb_bridge.route.lease import _FIRST_WITHIN, BEAT, GIVEN_UP_AFTER, LASTS, SLOW, LeaseHalf, Marker, Standstill

EPSILON = 1e-6


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


class Pair:
    """Two leases that hear each other at once."""

    def __init__(self, *, thread: bool = False) -> None:
        self.clock = Clock()
        self.ended: list[int] = []
        self.turns = RosTurns(lambda: None, self.clock) if thread else RosTurns()
        self.here = LeaseHalf(self.clock, self.turns, lambda: self.ended.append(0))
        self.there = LeaseHalf(self.clock, RosTurns(), lambda: self.ended.append(1))
        self.here.begin()
        self.there.begin()

    def exchange(self, way: float = 0.0) -> None:
        """Each sends a number, which the other hears `way` s later."""
        numbers = self.here.beat(), self.there.beat()
        self.clock.now += way
        self.there.hear(*numbers[0])
        self.here.hear(*numbers[1])

    def live(self, seconds: float) -> None:
        for _ in range(round(seconds / BEAT)):
            self.clock.now += BEAT
            self.turns.at = self.turns.since = self.clock.now
            self.exchange()


@pytest.fixture
def pair() -> Pair:
    made = Pair()
    made.exchange()
    made.exchange()
    return made


def test_it_is_alive_once_a_number_is_answered() -> None:
    pair = Pair()
    pair.exchange()
    assert [pair.here.alive, pair.there.alive] == [False, False]
    pair.exchange()
    assert [pair.here.alive, pair.there.alive] == [True, True]
    pair.live(100.0)
    assert [pair.here.alive, pair.there.alive] == [True, True]


def test_late_number_of_lease_before_begins_none(pair: Pair) -> None:
    """This side sends goals once it has begun; the other one must take them by then."""
    late = pair.there.beat()
    pair.here.end()
    pair.there.end()
    pair.here.hear(*late)
    pair.here.begin()
    pair.there.hear(*pair.here.beat())  # it knows by an operator's message, which comes next, that it is to begin
    pair.there.begin()
    while not pair.here.begun:
        pair.exchange(0.1)
    assert pair.there.alive


def test_number_of_lease_before_begins_none_however_late(pair: Pair) -> None:
    """Datagrams come late, and by then the next lease may have begun."""
    late = pair.there.beat()
    for side in (pair.here, pair.there):
        side.end()
        side.begin()
    pair.here.hear(*late)
    pair.there.hear(*pair.here.beat())
    pair.here.hear(*pair.there.beat())
    assert not pair.here.begun  # as the other side does not know yet that it is heard
    assert not pair.there.alive


def test_nothing_passes_second_after_last_answer(pair: Pair) -> None:
    number = pair.there.newest_before(pair.clock.now)
    pair.clock.now += LASTS - EPSILON
    assert pair.here.passes(number)
    pair.clock.now += 2 * EPSILON
    assert not pair.here.passes(number)
    assert not pair.here.alive


def test_older_message_does_not_pass_heard_peer(pair: Pair) -> None:
    number = pair.there.newest_before(pair.clock.now)
    pair.live(LASTS + BEAT)
    assert pair.here.alive
    assert not pair.here.passes(number)


@pytest.mark.parametrize("number", [0, 10**6], ids=["none", "one that was never sent"])
def test_message_with_unsent_number_does_not_pass(number: int, pair: Pair) -> None:
    assert not pair.here.passes(number)


def test_standstill_ends_lease_despite_first_answers(pair: Pair) -> None:
    answers = [pair.there.beat() for _ in range(3)]
    pair.clock.now += LASTS + EPSILON
    for answer in answers:
        pair.here.hear(*answer)
    assert (pair.here.over, pair.ended) == (Standstill.LOOP, [0])
    pair.exchange()
    pair.exchange()
    assert not pair.here.alive, "what ended is not revived"


def test_a_ros_thread_that_stands_still_ends_it() -> None:
    pair = Pair(thread=True)
    pair.live(1.0)
    assert pair.here.alive
    for _ in range(5):
        pair.clock.now += BEAT
        pair.exchange()
    assert pair.here.over is Standstill.ROS_THREAD


def test_a_silent_other_side_ends_it(pair: Pair) -> None:
    for _ in range(round(GIVEN_UP_AFTER / BEAT)):
        pair.clock.now += BEAT
        pair.here.beat()
        assert pair.here.over is None
    pair.clock.now += BEAT
    pair.here.beat()
    assert pair.here.over is Standstill.PEER


def test_one_that_does_not_begin_ends() -> None:
    """The link became slow after the first answer. Once it no longer is, nobody may want it any more."""
    pair = Pair()
    pair.exchange()
    pair.exchange()
    sent: list[int] = []
    for turn in range(round(_FIRST_WITHIN / BEAT) + 1):
        pair.clock.now += BEAT
        sent.append(pair.here.beat()[0])
        if turn >= 8:  # 2 s
            pair.here.hear(turn, sent[turn - 8])
    assert (pair.here.begun, pair.here.over) == (False, Standstill.PEER)


def test_link_with_long_round_trip_is_slow(pair: Pair) -> None:
    pair.exchange(SLOW + EPSILON)
    assert pair.here.slow
    pair.exchange()
    pair.exchange()
    assert not pair.here.slow


def test_sent_message_is_valid_for_one_second(pair: Pair) -> None:
    pair.clock.now += 0.4
    assert pair.here.left == pytest.approx(LASTS - 0.4)
    pair.clock.now += LASTS
    assert pair.here.left == 0.0


def test_messages_after_standstill_count_from_before() -> None:
    pair = Pair(thread=True)
    pair.live(1.0)
    marker = Marker(pair.here, pair.turns, batch=2)
    message = RawMessage(b"", 0)
    pair.clock.now += 0.1
    pair.turns.turned()
    before = marker.marked([message])[0].lease
    pair.clock.now += 0.8
    pair.exchange()
    assert pair.here.newest_before(pair.clock.now) > before
    pair.turns.turned()
    assert marker.marked([message])[0].lease == before
    pair.clock.now += LONGEST_WAIT / 2
    pair.turns.turned()
    assert marker.marked([message])[0].lease == before, "DDS may still bring what it held back"
    for _ in range(2):
        pair.clock.now += LONGEST_WAIT
        pair.turns.turned()
    assert marker.marked([message])[0].lease > before


def test_leftovers_are_as_old_as_what_preceded() -> None:
    pair = Pair(thread=True)
    pair.live(1.0)
    marker, message = Marker(pair.here, pair.turns, batch=2), RawMessage(b"", 0)
    first = marker.marked([message, message])[0].lease
    pair.live(1.0)
    assert [each.lease for each in marker.marked([message])] == [first]
    assert marker.marked([message])[0].lease > first


def test_late_arrivals_are_not_counted_as_leftovers() -> None:
    """Exactly a batch had come; the next command, later, was marked with a number of then, and dropped."""
    pair = Pair(thread=True)
    pair.live(1.0)
    marker, message = Marker(pair.here, pair.turns, batch=2), RawMessage(b"", 0)
    pair.turns.turned()
    first = marker.marked([message, message])[0].lease
    for _ in range(8):  # turns that find nothing
        pair.clock.now += BEAT
        pair.turns.turned()
        pair.exchange()
    pair.clock.now += BEAT
    pair.turns.turned()
    number = marker.marked([message])[0].lease
    assert number > first
    assert pair.there.passes(number)


def test_leftovers_are_as_old_as_their_turn() -> None:
    pair = Pair(thread=True)
    pair.live(1.0)
    marker, message = Marker(pair.here, pair.turns, batch=2), RawMessage(b"", 0)
    pair.turns.turned()
    first = marker.marked([message, message])[0].lease
    for _ in range(3):
        pair.clock.now += BEAT
        pair.exchange()
        pair.turns.turned()
        assert {each.lease for each in marker.marked([message, message])} == {first}


def test_only_watched_thread_notes_turns() -> None:
    clock, woken = Clock(), []
    turns = RosTurns(lambda: woken.append(1), clock)
    assert (turns.watched, turns.at) == (False, float("inf"))
    turns.watch("one")
    turns.watch("another")
    assert (turns.watched, turns.at, len(woken)) == (True, clock.now, 1)
    turns.leave("one")
    assert turns.watched
    turns.leave("another")
    assert (turns.watched, turns.at) == (False, float("inf"))
