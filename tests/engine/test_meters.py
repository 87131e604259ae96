"""What the meters make of clocks that are set while messages cross."""

from __future__ import annotations

import pytest

from rsb_bridge.meters import LatencyMeter


@pytest.mark.parametrize("absurd", [-1.79e9, -3600.0, 1.79e9])
def test_a_latency_that_only_a_set_clock_explains_is_none(absurd: float) -> None:
    meter = LatencyMeter()
    for transit in (0.002, 0.004, 0.003):
        meter.add(transit)
    meter.tick()
    assert meter.p50 == 0.003
    meter.add(absurd)
    meter.tick()
    assert (meter.p50, meter.p99, meter.jitter) == (None, None, None)
    meter.add(0.002)
    meter.tick()
    assert meter.p99 == 0.002
