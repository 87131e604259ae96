"""Meters with clocks that are set while messages cross."""

from __future__ import annotations

from random import Random

import pytest

from rsb_bridge.telemetry.meters import HISTORY, ClockOffset, LatencyMeter, RateMeter, Smoothed


@pytest.mark.parametrize("absurd", [-1.79e9, -3600.0, 1.79e9])
def test_latency_that_only_set_clock_explains_is_none(absurd: float) -> None:
    meter = LatencyMeter()
    for transit in (0.002, 0.004, 0.003):
        meter.add(transit)
    meter.tick(0.0)
    assert meter.percentiles()[0] == 0.003
    meter.add(absurd)
    meter.tick(0.0)
    assert (*meter.percentiles(), meter.jitter) == (None, None, None)
    meter.add(0.002)
    meter.tick(0.0)
    assert meter.percentiles()[1] == 0.002


def exchange(clock: ClockOffset, offset: float, there: float = 0.001, back: float = 0.001) -> None:
    """One ping and pong: seconds that they take, and the peer's clock minus ours."""
    sent = 10**18
    received = sent + int((there + offset) * 1e9)
    clock.add(sent, received, received, sent + int((there + back) * 1e9))


def test_clock_offset_is_that_of_shortest_round_trip() -> None:
    clock = ClockOffset()
    exchange(clock, offset=5.0)
    exchange(clock, offset=5.0, there=0.100)
    assert clock.offset == pytest.approx(5.0)
    assert clock.rtt == pytest.approx(0.101)
    assert clock.uncertainty == pytest.approx(0.001)
    exchange(clock, offset=5.001, there=0.050)  # within its bounds: no contradiction
    assert clock.offset == pytest.approx(5.0)


@pytest.mark.parametrize("step", [-3600.0, -0.01, 0.01, 30.0])
def test_set_clock_is_believed_at_next_exchange(step: float) -> None:
    clock = ClockOffset()
    for _ in range(20):
        exchange(clock, offset=0.2)
    exchange(clock, offset=0.2 + step, there=0.002)
    assert clock.offset == pytest.approx(0.2 + step, abs=clock.uncertainty)
    assert clock.uncertainty == pytest.approx(0.0015)


def test_clock_set_during_exchange_misleads_once() -> None:
    clock = ClockOffset()
    exchange(clock, offset=0.0)
    sent = 10**18
    clock.add(sent, sent + 1_000_000, sent + 1_000_000, sent - 10 * 10**9)  # ours was set back by 10 s meanwhile
    exchange(clock, offset=10.0)
    assert clock.offset == pytest.approx(10.0)
    assert clock.rtt == pytest.approx(0.002)


def run_meter(rate: float, lengths: list[float]) -> RateMeter:
    """A meter whose ticks are these many seconds apart, of a topic at that rate (Hz), with messages of 100 bytes."""
    meter, now, count = RateMeter(50.0), 0.0, 0
    for length in lengths:
        now += length
        messages = int(now * rate + 1e-6) - count
        count += messages
        meter.add(messages, 100 * messages, 50.0 + now)
        meter.tick(50.0 + now)
    return meter


@pytest.mark.parametrize("length", [1.0, 1.2, 1.7, 3.4, 40.0])
@pytest.mark.parametrize("rate", [10.0, 200.0])
def test_rate_is_right_whatever_time_between_ticks(rate: float, length: float) -> None:
    """Under load a tick comes late, and then has the messages of more than a second."""
    meter = run_meter(rate, [length] * 20)
    assert meter.rate == pytest.approx(rate, rel=0.03)
    assert meter.usual_rate == pytest.approx(rate, rel=0.03)
    assert meter.bytes_per_second == pytest.approx(100 * rate, rel=0.03)
    assert set(meter.history) <= {rate - 1, rate, rate + 1}


@pytest.mark.parametrize("seed", range(20))
def test_rested_meter_shows_what_ticked_one_shows(seed: int) -> None:
    """Messages come in bursts, after pauses of minutes or hours in which one of both meters is not ticked."""
    random = Random(seed)
    ticked, resting = RateMeter(0.0), RateMeter(0.0)
    now, rests_from = 0.0, 0.0
    for _ in range(10):
        for _ in range(random.randint(1, 40)):  # s of messages
            now += 1.0
            messages, came = random.choice([0, 1, 1, 10, 300]), now - random.random()
            if now - 1.0 > rests_from:
                resting.rested(now - 1.0)
            for meter in (ticked, resting):
                if messages:
                    meter.add(messages, 100 * messages, came)
                meter.tick(now)
            rests_from = now
            assert figures(resting) == figures(ticked)
        for second in range(random.choice([1, 30, 130, 4000])):
            now += 1.0
            ticked.tick(now)
            if second < HISTORY + 1:
                resting.tick(now)
                rests_from = now
        assert figures(resting) == figures(ticked)


def figures(meter: RateMeter) -> tuple[object, ...]:
    return meter.rate, meter.usual_rate, meter.regular, meter.bytes_per_second, [*meter.history], meter.last


def test_the_history_has_an_entry_for_every_second() -> None:
    meter = run_meter(10.0, [1.0] * 5 + [3.4] + [1.0] * 5)
    assert len(meter.history) == 13
    assert sum(meter.history) == pytest.approx(134, abs=3)


def test_single_message_is_shown_after_long_pause() -> None:
    meter = RateMeter(0.0)
    meter.add(1, 100, 3.0)
    meter.tick(3.1)
    assert sum(meter.history) == 1


def test_a_tick_right_after_another_makes_no_rate() -> None:
    meter = run_meter(10.0, [1.0] * 10)
    meter.add(1, 100, 60.001)
    meter.tick(60.001)
    assert meter.rate == pytest.approx(10.0)
    assert meter.history[-1] == 10


@pytest.mark.parametrize(("rate", "seconds"), [(2, 8), (1, 8), (0.2, 40)])
def test_rate_falls_after_last_message_to_zero(rate: float, seconds: int) -> None:
    """Without a usual rate yet, only silence shows the end."""
    meter = RateMeter(0.0)
    for second in range(1, seconds + 1):
        if second % max(1, round(1 / rate)) == 0:
            meter.add(max(1, round(rate)), 10, float(second))
        meter.tick(float(second))
    assert meter.rate == pytest.approx(rate, rel=0.1)
    assert meter.usual_rate is None
    rates = []
    for second in range(seconds + 1, seconds + 40):
        meter.tick(float(second))
        rates.append(meter.rate)
    assert rates == sorted(rates, reverse=True)
    assert rates[9] <= 0.1
    assert rates[-1] == 0.0


def test_a_rate_of_nothing_comes_to_zero() -> None:
    rate = Smoothed(0.0)
    rate.add(1e6, 1.0)
    assert rate.rate == 5e5
    for second in range(2, 60):
        rate.add(0.0, float(second))
    assert rate.rate == 0.0


def test_one_way_delay_does_not_move_clock() -> None:
    """A tunnel holds everything up for 12 s on the way there."""
    clock = ClockOffset()
    second = 10**9
    clock.add(0, second, second, second // 500)  # the peer's clock is 0.999 s ahead
    for now in range(20, 60):
        clock.add(now * second, (now + 13) * second, (now + 13) * second, (now + 12) * second)
    assert clock.offset == pytest.approx(0.999)
    assert clock.uncertainty is not None
    assert clock.uncertainty < 0.02


def publish(meter: RateMeter, began: float, rates: list[float], seconds: int = 40) -> list[float | None]:
    """Have publishers of these rates (Hz) publish from a time on; return the usual rate after each second."""
    meter.publishers, usual = len(rates), []
    for second in range(seconds):
        now = began + second + 1.0
        messages = sum(int(rate * (second + 1)) - int(rate * second) for rate in rates)
        meter.add(messages, 100 * messages, now)
        meter.tick(now)
        usual.append(meter.usual_rate)
    return usual


def test_each_number_of_publishers_has_its_usual_rate() -> None:
    meter = RateMeter(0.0)
    assert publish(meter, 0.0, [10.0])[-1] == pytest.approx(10.0)
    assert publish(meter, 40.0, [10.0, 10.0])[-1] == pytest.approx(20.0)
    assert publish(meter, 80.0, [10.0]) == [pytest.approx(10.0)] * 40
    assert publish(meter, 120.0, [10.0, 10.0]) == [pytest.approx(20.0)] * 40


def test_unknown_rate_of_fewer_publishers_is_learned_anew() -> None:
    meter = RateMeter(0.0)
    publish(meter, 0.0, [10.0, 10.0])
    usual = publish(meter, 40.0, [10.0])
    assert usual[0] is None
    assert usual[-1] == pytest.approx(10.0)
    assert meter.regular


def test_silence_changes_no_usual_rate() -> None:
    """One that has died is still listed, or has gone: what it published is missing."""
    meter = RateMeter(0.0)
    publish(meter, 0.0, [10.0, 10.0])
    for publishers in (1, 0):
        meter.publishers = publishers
        meter.tick(41.0 + publishers)
        assert meter.usual_rate == pytest.approx(20.0)
        assert meter.regular
