"""Publishers that are simulated on a clock of their own: who is called stopped or slow, and after how long."""

from __future__ import annotations

import math
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from rsb_bridge.model.snapshot import Ledger
from rsb_bridge.route.health import Health
from rsb_bridge.telemetry.meters import RateMeter, UsualRate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    Gaps = Callable[[Random], Iterator[float]]

SEEDS = range(3)


class Watched(NamedTuple):
    """Verdicts of a publisher: when it was called stopped (s), and how often slow."""

    stopped: list[float]
    slow: int


def watched(
    gaps: Gaps, seconds: float, seed: int, *, outages: Sequence[tuple[float, float]] = (), given: float = 0.0
) -> Watched:
    """Have a publisher publish, and look at it once a second.

    Args:
        gaps: gives the time (s) from each message to the next.
        outages: from when until when (s) it is dead; then another one takes its place.
        given: Hz that an operator expects, or 0.
    """
    random = Random(seed)
    times, due = [], random.random()
    for gap in gaps(random):
        if due > seconds:
            break
        if not any(begin <= due < end for begin, end in outages):
            times.append(due)
        due += gap
    meter, health = RateMeter(0.0), Health()
    stopped: list[float] = []
    slow, sent, second = 0, 0, 0
    while (second := second + 1) < seconds:
        now = second + random.uniform(0.0, 0.02)
        while sent < len(times) and times[sent] <= now:
            meter.add(1, 100, times[sent])
            sent += 1
        meter.tick(now)
        publishers: Any = [SimpleNamespace(gid=b"%d" % sum(end <= now for _, end in outages))]
        route: Any = SimpleNamespace(
            spec=SimpleNamespace(expected_rate=given),
            meter=meter,
            limit=SimpleNamespace(rate=0.0),
        )
        had_stopped, was_slow = health.stop.since is not None, health.slow.since is not None
        last, usual = meter.last or 0.0, meter.usual_rate
        health.judge(route, Ledger(), now, publishers, usual_rate=usual, quiet_since=last, flows=True, awaited=True)
        if health.stop.since is not None and not had_stopped:
            stopped.append(now)
        slow += health.slow.since is not None and not was_slow
    return Watched(stopped, slow)


def endless(gap: Callable[[Random], float]) -> Gaps:
    def gaps(random: Random) -> Iterator[float]:
        while True:
            yield gap(random)

    return gaps


def jittered(period: float, share: float) -> Gaps:
    return endless(lambda random: period * random.uniform(1 - share, 1 + share))


def poisson(rate: float) -> Gaps:
    return endless(lambda random: random.expovariate(rate))


def bursts(most: int, period: float, shortest: float, longest: float) -> Gaps:
    def gaps(random: Random) -> Iterator[float]:
        while True:
            yield from [period] * random.randint(1, most)
            yield random.uniform(shortest, longest)

    return gaps


def changing(first: float, last: float, seconds: float) -> Gaps:
    """The period changes slowly from the one to the other."""

    def gaps(random: Random) -> Iterator[float]:
        now = 0.0
        while True:
            period = first + (last - first) * min(1.0, now / seconds)
            now += period
            yield period

    return gaps


@pytest.mark.parametrize(
    "gaps",
    [
        endless(lambda random: random.uniform(0.2, 5.0)),
        poisson(0.3),
        poisson(1.0),
        poisson(3.0),
        poisson(10.0),
        bursts(20, 0.05, 2.0, 30.0),
        bursts(20, 0.05, 30.0, 30.0),
        bursts(200, 0.05, 1.0, 10.0),
        endless(lambda random: random.lognormvariate(math.log(0.5), 1.0)),
        endless(lambda random: random.lognormvariate(math.log(0.3), 1.5)),
    ],
    ids=["gaps of 0.2-5 s", "0.3 Hz", "1 Hz", "3 Hz", "10 Hz", "bursts", "rare", "long", "skewed", "very skewed"],
)
def test_random_and_bursty_messages_are_not_stopped(gaps: Gaps) -> None:
    all_of_them = [watched(gaps, 900.0, seed) for seed in SEEDS]
    assert sum(len(each.stopped) for each in all_of_them) <= 2  # in two hours, where long bursts are regular themselves
    assert sum(each.slow for each in all_of_them) <= 2


@pytest.mark.parametrize(
    "gaps",
    [changing(0.1, 1.0, 600.0), changing(1.0, 0.1, 600.0), changing(0.5, 5.0, 1800.0)],
    ids=["falls", "rises", "falls far"],
)
def test_slowly_changing_rate_has_not_stopped(gaps: Gaps) -> None:
    assert [watched(gaps, 1800.0, seed).stopped for seed in SEEDS] == [[]] * len(SEEDS)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("period", [0.01, 0.1, 1.0, 5.0])
def test_dying_regular_publisher_is_noticed_each_time(period: float, share: float) -> None:
    """A node that is started again is another publisher, so that it may die again."""
    begin = 100.0 + 30 * period
    outages = [(begin, begin + 60.0), (2 * begin + 60.0, 2 * begin + 120.0)]
    for seed in SEEDS:
        said = watched(jittered(period, share), outages[-1][1], seed, outages=outages)
        assert len(said.stopped) == len(outages)
        for (died, _), noticed in zip(outages, said.stopped, strict=True):
            assert died < noticed <= died + max(2.0, 5 * period * (1 + share)) + 1.1
        assert not said.slow


def test_pausing_publisher_stops_only_by_longer_pauses() -> None:
    """A joystick is let go of again and again, for up to a minute."""

    def joystick(random: Random) -> Iterator[float]:
        while True:
            yield from [0.05] * int(20 * random.expovariate(1 / 40))
            yield random.uniform(1.0, 60.0)

    assert max(len(watched(joystick, 3600.0, seed).stopped) for seed in SEEDS) <= 4


def test_given_rate_counts_for_every_pause() -> None:
    outages = [(100.0 * number, 100.0 * number + 8.0) for number in range(1, 6)]
    gaps = [jittered(1.0, 0.0), poisson(5.0)]
    for each in gaps:
        assert len(watched(each, 600.0, 1, outages=outages, given=1.0).stopped) == len(outages)


class AddedUp(UsualRate):
    """Adds all of its samples up anew whenever one comes."""

    __slots__ = ()

    def _sample(self, gaps: int, seconds: float) -> None:
        super()._sample(gaps, seconds)
        self._sums = (
            sum(each for each, _ in self._samples),
            sum(each for _, each in self._samples),
            sum(each * each / count for count, each in self._samples),
        )


@pytest.mark.parametrize("seed", range(8))
def test_sums_kept_up_to_date_learn_the_same(seed: int) -> None:
    random, now, last = Random(seed), 0.0, 0.0
    kept, added_up = UsualRate(), AddedUp()
    for second in range(4000):
        if second % 300 == 0:
            rate, noise, publishers = random.choice([0.1, 1.0, 10.0, 800.0]), random.choice([0.0, 0.05, 2.0]), 1
        now += 1.0
        if second % 1000 == 999:
            publishers = 2
        messages = int(rate * (now - last) + random.uniform(-noise, noise))
        if messages > 0:
            last = min(now, last + messages / rate)
        for each in (kept, added_up):
            each.published_by(publishers)
            each.add(max(0, messages), last, now)
        assert kept.regular == added_up.regular
        assert kept.rate == pytest.approx(added_up.rate, rel=1e-9)
