"""The messages of a benchmark on this machine."""

from __future__ import annotations

from rsb_bridge.ros.known_messages import stamped_string
from rsb_bridge.ros.traffic import Arrivals


def test_what_an_earlier_run_has_left_does_not_count_for_the_next() -> None:
    arrivals, late = Arrivals(), stamped_string(100)
    arrivals.take(late)
    assert (arrivals.count, len(arrivals.latencies)) == (1, 1)
    arrivals.reset()
    arrivals.take(late)
    arrivals.take(stamped_string(100))
    assert (arrivals.count, len(arrivals.latencies)) == (1, 1)
