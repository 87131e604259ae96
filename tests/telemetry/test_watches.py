"""Learning of a usual rate, and verdicts of slow, stopped or lossy messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import FINE, Cause, Verdict
from rsb_bridge.route.combined_verdict import Announcer
from rsb_bridge.telemetry.meters import RateMeter, UsualRate
from rsb_bridge.telemetry.watches import LossWatch, SlowWatch, StopWatch

if TYPE_CHECKING:
    from collections.abc import Iterable


class Learner:
    """Has a rate learned from how many messages come in each second, the last one at its end."""

    def __init__(self) -> None:
        self.now = 0.0
        self.usual = UsualRate()

    def learn(self, counts: Iterable[int]) -> Learner:
        for messages in counts:
            self.now += 1.0
            self.usual.add(messages, self.now, self.now)
        return self

    @property
    def rate(self) -> float | None:
        return self.usual.rate


def learned(counts: Iterable[int], usual: Learner | None = None) -> Learner:
    return (usual or Learner()).learn(counts)


@pytest.mark.parametrize("rate", [1, 3, 20, 1000])
def test_a_regular_rate_is_learned_within_seconds(rate: int) -> None:
    assert learned([rate] * 20).rate == pytest.approx(rate, rel=0.02)


def test_a_slow_topics_rate_is_learned() -> None:
    assert learned([1, 0, 0, 0, 0] * 20).rate == pytest.approx(0.2, rel=0.02)


def test_bursts_have_no_usual_rate() -> None:
    assert learned([20, 0, 0, 3, 0, 55, 1, 0, 0, 0, 7, 100, 2] * 10).rate is None


@pytest.mark.parametrize("length", [3, 10, 60, 600])
def test_an_outage_teaches_nothing(length: int) -> None:
    usual = learned([20] * 30)
    learned([13, *[0] * length, 7, *[20] * 30], usual)
    assert usual.rate == pytest.approx(20, rel=0.02)


def test_a_catch_up_after_a_stall_teaches_nothing() -> None:
    usual = learned([20] * 30)
    learned([0, 0, 60, 20, 0, 0, 0, 0, 100, *[20] * 30], usual)
    assert usual.rate == pytest.approx(20, rel=0.02)


def test_faster_rate_is_learned_sooner_than_slower() -> None:
    usual = learned([20] * 30)
    assert learned([2] * 300, usual).rate == pytest.approx(20, rel=0.02)
    assert learned([2] * 400, usual).rate == pytest.approx(2, rel=0.02)
    assert learned([20] * 21, usual).rate == pytest.approx(20, rel=0.02)


@pytest.mark.parametrize("known", [0, 30])
def test_trouble_teaches_no_rate(known: int) -> None:
    """A full link carries 2 of 7 Hz for eleven minutes, and is noticed to be full after 5 s."""
    usual = learned([7] * known)
    learned([2] * 5, usual)
    for _ in range(660):
        usual.now += 1.0
        usual.usual.skip(usual.now)
    assert usual.rate == (pytest.approx(7) if known else None)
    assert learned([7] * 20, usual).rate == pytest.approx(7)


@given(st.lists(st.integers(0, 1000), max_size=300))
def test_whatever_comes_rate_is_one_that_was_there(counts: list[int]) -> None:
    usual = learned(counts)
    assert usual.rate is None or 0 < usual.rate <= max(counts)


def slow(watch: SlowWatch, rates: list[float], start: float = 0.0) -> list[bool]:
    said = []
    for number, rate in enumerate(rates):
        watch.judge(rate, 20.0, start + number)
        said.append(watch.since is not None)
    return said


def test_slow_after_five_seconds_ends_after_three() -> None:
    watch = SlowWatch()
    assert slow(watch, [20.0] * 3 + [2.0] * 6) == [False] * 7 + [True] * 2
    assert slow(watch, [18.0] * 4, 9.0) == [True, True, False, False]


def test_a_rate_about_the_threshold_does_not_flap() -> None:
    watch = SlowWatch()
    assert not any(slow(watch, [13.0, 15.0] * 30))
    slow(watch, [2.0] * 6)
    assert all(slow(watch, [13.0, 16.5] * 30))


A, B = frozenset({b"a"}), frozenset({b"b"})
"""Publishers of a topic."""


def test_topic_has_stopped_after_five_of_its_periods() -> None:
    watch = StopWatch()
    watch.judge(10.0, 1.0, 15.0, A)
    assert watch.since is None
    watch.judge(10.0, 1.0, 15.1, A)
    assert watch.since == 10.0
    fast = StopWatch()
    fast.judge(10.0, 100.0, 11.9, A)
    assert fast.since is None
    fast.judge(10.0, 100.0, 12.1, A)
    assert fast.since == 10.0


def test_only_longer_pause_counts_for_same_publisher() -> None:
    watch = StopWatch()
    watch.judge(10.0, 20.0, 15.0, A)
    assert watch.since == 10.0
    watch.judge(16.0, 20.0, 16.0, A)
    for now, stopped in ((19.0, False), (27.9, False), (28.1, True)):  # it has paused for 6 s
        watch.judge(16.0, 20.0, now, A)
        assert watch.quiet
        assert (watch.since is not None) is stopped
    watch.judge(100.0, 20.0, 100.0, B)
    watch.judge(100.0, 20.0, 103.0, B)
    assert watch.since == 100.0
    resumed = 100.0 + 62 * 3600.0
    watch.judge(resumed, 20.0, resumed, B)
    watch.judge(resumed, 20.0, resumed + 1201.0, B)
    assert watch.since == resumed, "a weekend without power is no pause to expect"


def test_new_publisher_has_time_for_its_first_message() -> None:
    watch = StopWatch()
    watch.judge(10.0, 20.0, 10.0, A)
    watch.judge(10.0, 20.0, 11.5, A | B)  # DDS lists a dead publisher and its successor
    watch.judge(10.0, 20.0, 13.4, A | B)
    assert (watch.since, watch.quiet, watch.new) == (None, False, B)
    watch.judge(10.0, 20.0, 13.6, A | B)
    assert (watch.since, watch.new) == (10.0, B)
    watch.judge(14.0, 20.0, 14.0, A | B)
    assert (watch.since, watch.new) == (None, frozenset())


def test_stopped_topic_recovers_by_no_silent_publisher() -> None:
    watch = StopWatch()
    watch.judge(10.0, 20.0, 10.0, A)
    watch.judge(10.0, 20.0, 12.1, frozenset())
    for now in (13.0, 14.0, 16.0):
        watch.judge(10.0, 20.0, now, B)
        assert (watch.since, watch.new) == (10.0, B)


def lossy(watch: LossWatch, seconds: Iterable[tuple[int, int]], state: list[int]) -> None:
    """Ticks with so many messages delivered and lost each; `state` is the time and both counts so far."""
    for delivered, lost in seconds:
        state[:] = [state[0] + 1, state[1] + delivered, state[2] + lost]
        watch.judge(state[1], {"lost on the way": state[2], "link lost": 10 * state[2]}, float(state[0]))


def test_losses_are_counted_over_the_last_ten_seconds() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(10, 0)] * 20, state)
    assert watch.loss is None
    lossy(watch, [(5, 5)] * 10, state)
    assert watch.loss is not None
    assert (watch.loss.lost, watch.loss.of, watch.loss.cause) == (50, 100, "lost on the way")
    assert watch.loss.since == 21.0
    lossy(watch, [(10, 0)] * 10, state)
    assert watch.loss is None


def test_a_few_lost_messages_are_no_fault() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(10, 0)] * 5 + [(9, 1)] + [(10, 0)] * 9 + [(8, 2)] + [(10, 0)] * 9, state)
    assert watch.loss is None


def test_what_was_dropped_as_disarmed_is_not_lost() -> None:
    watch = LossWatch()
    for second in range(12):
        watch.judge(100, {"disarmed": 20 * second}, float(second))
    assert watch.loss is None


def test_total_loss_lasts_while_nothing_is_sent() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(0, 10)] * 5 + [(0, 0)] * 5, state)
    assert watch.loss is not None
    assert watch.loss.share == 1.0
    lossy(watch, [(0, 0)] * 8, state)
    assert watch.loss is None


SLOW = Verdict(State.SLOW, Cause.SLOW, "2 Hz of 20")
UNHEARD = Verdict(State.UNHEARD, Cause.NO_SUBSCRIBER, "nobody subscribes")


def said(announcer: Announcer, verdicts: Iterable[Verdict], start: float = 0.0) -> list[tuple[float, EventCode, str]]:
    return [
        (now, announcement.code, announcement.cause)
        for now, verdict in enumerate(verdicts, int(start))
        if (announcement := announcer.announce(verdict, float(now)))
    ]


def test_turn_for_worse_is_told_once_with_end() -> None:
    heard = said(Announcer(), [FINE] * 5 + [SLOW] * 20 + [FINE] * 20)
    assert heard == [(8, EventCode.ROUTE_FAULT, Cause.SLOW), (28, EventCode.ROUTE_RECOVERED, Cause.SLOW)]


def test_changing_state_is_told_once_a_minute() -> None:
    announcer = Announcer()
    assert said(announcer, [FINE, SLOW] * 600) == []
    heard = said(announcer, ([FINE] * 5 + [SLOW] * 5) * 60, 1200.0)
    faults = [now for now, code, _ in heard if code is EventCode.ROUTE_FAULT]
    assert 8 <= len(faults) <= 10
    assert len(heard) <= 2 * len(faults)


def test_fault_whose_cause_changes_each_second_is_said() -> None:
    late = Verdict(State.LATE, Cause.LATE, "2 s late")
    assert [code for _, code, _ in said(Announcer(), [FINE] * 5 + [SLOW, late] * 20)] == [EventCode.ROUTE_FAULT]


def test_newly_unheard_is_told_never_heard_is_not() -> None:
    assert said(Announcer(), [UNHEARD] * 100) == []
    assert [code for _, code, _ in said(Announcer(), [FINE] * 5 + [UNHEARD] * 5)] == [EventCode.ROUTE_FAULT]


def test_waiting_cause_is_told_once_after_delay() -> None:
    waiting = Verdict(State.WAITING, Cause.NO_PUBLISHER, "no publisher of /w_tpyo; did you mean /w_typo?")
    down = Verdict(State.DOWN, Cause.LINK_DOWN, "gone")
    assert said(Announcer(), [waiting] * 9 + [FINE] * 9 + [waiting] * 9) == []
    heard = said(Announcer(), ([waiting] * 60 + [down] * 20) * 10 + [FINE] * 5, 100.0)
    assert heard == [
        (110, EventCode.ROUTE_WAITING, Cause.NO_PUBLISHER),
        (903, EventCode.ROUTE_RECOVERED, Cause.NO_PUBLISHER),
    ]


def test_undue_messages_are_not_missed() -> None:
    for cause in (Cause.NO_MESSAGE, Cause.PUBLISHER_SILENT, "of a newer peer"):
        assert said(Announcer(), [Verdict(State.WAITING, cause, "waits")] * 100) == []


def test_waiting_topic_that_turns_stale_is_fault() -> None:
    states = [Verdict(state, Cause.NO_PUBLISHER, "nobody") for state in (State.WAITING, State.STALE)]
    heard = said(Announcer(), [states[0]] * 15 + [states[1]] * 100)
    assert [code for _, code, _ in heard] == [EventCode.ROUTE_WAITING, EventCode.ROUTE_FAULT]


@pytest.mark.parametrize(
    ("gaps", "regular"),
    [
        ([1.0] * 6, True),
        ([0.1] * 60, True),
        ([2.0, 2.1, 1.9, 2.0, 2.0, 2.1], True),
        ([1.0] * 3, False),
        ([0.02] * 30, False),
        ([4.0, 9.0, 3.0, 20.0, 6.0, 30.0], False),
        ([0.1, 0.1, 8.0, 0.1, 12.0, 0.1, 0.1, 3.0], False),
    ],
)
def test_silence_means_something_after_messages_at_a_rhythm(gaps: list[float], regular: bool) -> None:
    """A few messages at the times that an operator clicks are none."""
    meter, now, due = RateMeter(0.0), 0.0, [0.5]
    for gap in gaps:
        due.append(due[-1] + gap)
    for _ in range(int(due[-1]) + 20):
        now += 1.0
        while due and due[0] <= now:
            meter.add(1, 100, due.pop(0))
        meter.tick(now)
    assert meter.regular is regular


def test_a_topic_recovers_soon_after_the_last_loss() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(5, 2)] * 20, state)
    assert watch.loss is not None
    lossy(watch, [(7, 0)] * 3, state)
    assert watch.loss is not None
    assert watch.loss.recovering
    lossy(watch, [(7, 0)] * 3, state)
    assert watch.loss is None
    lossy(watch, [(7, 0)] * 3 + [(6, 1)] + [(7, 0)] * 5, state)
    assert watch.loss is None, "earlier losses do not count again"


def test_topic_below_bound_recovers_despite_losses() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(90, 10)] * 10, state)
    seen = []
    for _ in range(25):
        lossy(watch, [(97, 3)], state)
        seen.append("none" if watch.loss is None else "recovering" if watch.loss.recovering else "lossy")
    assert seen[-1] == "none"
    assert sorted(seen, key=["lossy", "recovering", "none"].index) == seen


def test_rare_loss_is_no_recovery_in_between() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(0, 1), (1, 0), (1, 0), (1, 0), (1, 0)] * 4, state)
    lossy(watch, [(0, 1)] * 3, state)
    assert watch.loss is not None
    lossy(watch, [(1, 0)] * 4, state)
    assert watch.loss is not None
    assert not watch.loss.recovering


def test_rare_messages_that_are_all_lost_are_fault() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(1, 0)], state)
    for lost in range(1, 5):
        lossy(watch, [(0, 0)] * 29 + [(0, 1)], state)
        assert (watch.loss is not None) is (lost >= 3)
    assert watch.loss is not None
    assert (watch.loss.lost, watch.loss.of) == (4, 4)
    lossy(watch, [(1, 0), *[(0, 0)] * 10], state)
    assert watch.loss is None


def test_all_are_lost_since_the_last_that_arrived() -> None:
    watch, state = LossWatch(), [0, 0, 0]
    lossy(watch, [(5, 5)] * 20, state)
    lossy(watch, [(0, 10)] * 15, state)
    assert watch.loss is not None
    assert (watch.loss.lost, watch.loss.of, watch.loss.since) == (100, 100, 20)
