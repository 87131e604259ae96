"""When a topic is late, and when it is in time again."""

from __future__ import annotations

from itertools import count, islice

import pytest
from tests.route.topic_verdict_helpers import NOW, RECEIVER, SENDER, verdict_on

from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.lateness import (
    QUEUE,
    WAY,
    Late,
    LateWatch,
    SendersDelay,
    delay_of_sender,
    seconds_text,
)
from rsb_bridge.route.notices import ChannelLosses
from rsb_bridge.telemetry.meters import LatencyMeter
from rsb_bridge.telemetry.watches import Loss

FULL = Fullness(25e3, 48e3, ("/camera",))
LATE = Late(12.0, 0.003, WAY, None, NOW - 5)


def watched(*delays: float | None, bound: float = 1.0, uncertainty: float = 0.0) -> LateWatch:
    watch = LateWatch()
    for second, delay in enumerate(delays):
        watch.judge(delay, uncertainty, bound, float(second), delay, own=delay or 0.0)
    return watch


@pytest.mark.parametrize(
    ("delays", "since"),
    [
        ((0.1, 1.5), None),  # one look may be a hiccup
        ((0.1, 1.5, 1.6), 1.0),
        ((0.1, 2.5), 1.0),  # far beyond the bound
        ((0.1, 1.5, 0.1, 1.5), None),
        ((3.0, 0.1), 0.0),
        ((3.0, 0.1, 0.1), None),
        ((3.0, 0.9, 0.9, 0.9), 0.0),  # so near the bound it would flap
        ((3.0, None, None, None), 0.0),
        ((3.0, None, None, None, None, None), None),  # no message comes any more: the age is unknown
    ],
)
def test_it_changes_its_mind_slowly(delays: tuple[float | None, ...], since: float | None) -> None:
    assert watched(*delays).since == since


def test_what_the_clocks_may_explain_is_not_late() -> None:
    assert watched(3.0, 3.0, uncertainty=2.5).since is None
    assert watched(3.0, 3.0, uncertainty=0.5).since is not None


def test_a_clock_that_is_set_makes_nothing_late() -> None:
    """Until the next exchange of pings, messages seem to take as long as the clock was set forward."""
    watch = LateWatch()
    for second, delay in enumerate((0.003, 10.0, 0.003, 0.003)):
        watch.judge(delay, 0.001, 1.0, float(second), delay)
        assert watch.since is None
    for second in (4, 5):
        watch.judge(10.0, 0.001, 1.0, float(second), 10.0)
    assert watch.since == 4.0


def test_seldom_topic_stays_late_between_messages() -> None:
    watch = LateWatch()
    states = []
    for second in range(100):
        delay = 5.0 if second % 10 == 0 else None
        watch.judge(delay, 0.0, 1.0, float(second), delay)
        states.append(watch.since is not None)
    assert all(states[10:])
    assert watch.since == 0.0
    for second in range(100, 130):
        watch.judge(None, 0.0, 1.0, float(second), None)
    assert watch.since is None, "no message comes any more: the age is unknown"


def test_0_accepts_any_delay() -> None:
    assert watched(50.0, 50.0, bound=0.0).since is None


def test_usual_delay_is_learned_in_good_times() -> None:
    watch = watched(*[0.003] * 6, 0.4, 0.8, 12.0, 12.0)
    assert watch.seconds == 12.0
    assert watch.usual == pytest.approx(0.003)


def test_no_delay_of_a_full_link_is_usual() -> None:
    watch = LateWatch()
    for second in range(60):
        watch.judge(0.4, 0.0, 1.0, float(second), 0.4, learns=second < 4 or second > 50)
        assert watch.usual is None or second > 55


def test_how_long_ago_oldest_unreported_message_was_sent() -> None:
    delays = SendersDelay()
    assert delays.unreported(0, 0, 0.0) == 0.0
    delays.unreported(10, 0, 1.0)
    assert delays.unreported(20, 0, 2.0) == pytest.approx(1.9)
    assert delays.unreported(30, 10, 3.0) == pytest.approx(1.9)
    assert delays.unreported(30, 30, 4.0) == 0.0
    assert delays.unreported(5, 0, 5.0) == pytest.approx(0.0, abs=1.0), "it was opened again"


def test_delay_of_reports_is_not_messages_delay() -> None:
    assert delay_of_sender(7.0, 3.0) == 3.0
    assert delay_of_sender(0.9, 0.0) == 0.0


@pytest.mark.parametrize(
    "late", [LATE, LATE._replace(where=QUEUE), LATE._replace(full=FULL), LATE._replace(usual=None)]
)
def test_a_late_topic_is_late_on_either_side(late: Late) -> None:
    for side in (SENDER, RECEIVER):
        verdict = verdict_on(side, late=late)
        assert (verdict.state, verdict.cause, verdict.since) == (State.LATE, Cause.LATE, NOW - 5)


def test_what_is_worse_and_what_is_not() -> None:
    assert verdict_on(SENDER, late=LATE, slow_since=NOW, expected_rate=20.0, rate=2.0).state is State.LATE
    assert verdict_on(SENDER, late=LATE, stopped_since=NOW - 9, expected_rate=20.0).state is State.STOPPED
    assert verdict_on(SENDER, late=LATE, link_down="gone").cause == Cause.LINK_DOWN


@pytest.mark.parametrize(("lost", "state"), [(10, State.SLOW), (20, State.DOWN)])
@pytest.mark.parametrize("cause", ["lost on the way", "incomplete", "queue full"])
def test_what_is_lost_on_full_link_is_overload(lost: int, state: State, cause: str) -> None:
    verdict = verdict_on(SENDER, loss=Loss(lost, 20, cause, NOW), full=FULL, datagrams=36)
    assert (verdict.state, verdict.cause) == (state, Cause.QUEUE_FULL if cause == "queue full" else Cause.LOSSY)
    assert FULL.share in verdict.text
    assert "tcp" not in verdict.text
    assert "MTU" not in verdict.text
    assert verdict_on(SENDER, loss=Loss(lost, 20, "too large", NOW), full=FULL).cause == Cause.TOO_LARGE


def test_previous_connections_messages_tell_nothing_of_path() -> None:
    class Loop:
        def call_later(self, *_: object) -> Loop:
            return self

        def cancel(self) -> None:
            pass

    losses = ChannelLosses()
    losses.arrived()
    losses.add(Reason("cut", EndCode.TIMED_OUT), Loop(), lambda: None, owing=True)  # type: ignore[arg-type]
    assert not losses.repeated
    losses.add(Reason("cut", EndCode.TIMED_OUT), Loop(), lambda: None, owing=True)  # type: ignore[arg-type]
    assert losses.repeated, "nothing has come over this one"


def test_the_recent_latency_is_of_the_last_second() -> None:
    meter = LatencyMeter()
    for transit in [0.003] * 500:
        meter.add(transit)
    meter.tick(1.0)
    for transit in (12.0, 12.2, 12.1):
        meter.add(transit)
    meter.tick(2.0)
    assert (meter.recent, meter.percentiles()[0]) == (12.1, 0.003)
    meter.tick(3.0)
    assert (meter.recent, meter.percentiles()[0]) == (None, 0.003)


def test_seconds_have_two_figures() -> None:
    assert [seconds_text(each) for each in (0.0004, 0.003, 1.42, 185)] == ["under 1 ms", "3 ms", "1.4 s", "3 min"]


def test_shown_latency_is_of_last_ten_seconds() -> None:
    """A jam of 15 s: nothing comes, then messages that are 2 s old, then again the usual ones."""
    meter, seconds = LatencyMeter(10.0), count()

    def ticks(number: int, *transits: float) -> tuple[float | None, float | None]:
        for now in islice(seconds, number):
            for transit in transits:
                meter.add(transit)
            meter.tick(now)
        return meter.percentiles()

    assert ticks(400, 0.01, 0.01) == (0.01, 0.01)
    assert ticks(15) == (None, None)
    assert meter.jitter is not None
    assert ticks(5, 2.0) == (2.0, 2.0)
    assert ticks(6, 0.01) == (0.01, 2.0)
    assert ticks(5, 0.01) == (0.01, 0.01)
    assert ticks(3, *[0.01] * 5000) == (0.01, 0.01)
    assert ticks(11) == (None, None)


def test_figures_of_other_side_count_for_as_long() -> None:
    meter = LatencyMeter(10.0)
    meter.take_reported(0.01, 0.02, 0.0, 5.0)
    meter.tick(14.9)
    assert meter.percentiles() == (0.01, 0.02)
    meter.tick(15.0)
    assert (*meter.percentiles(), meter.jitter) == (None, None, 0.0)


@pytest.mark.parametrize("mistake", [float("nan"), float("inf"), -float("inf"), 1e9])
def test_what_cannot_be_a_delay_is_no_report(mistake: float) -> None:
    delays = SendersDelay()
    delays.receive(mistake, 1.0)
    assert (delays.reported, delays.measure(0.5, 0.0, 1.0)) == (None, None)
    delays.receive(0.2, 1.0)
    delays.receive(mistake, 1.5)
    assert delays.measure(0.0, 0.05, 2.0) == 0.2
    assert delays.least == pytest.approx(0.15)
