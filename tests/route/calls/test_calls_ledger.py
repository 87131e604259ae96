"""One side's counts of its calls."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.route.calls.calls_ledger import CallsLedger
from rsb_bridge.wire.headers import MOST_TOOK

CALLS = st.tuples(st.integers(0, MOST_TOOK) | st.integers(0, 10**10), st.floats(0.0, 3600.0))


@given(st.lists(CALLS, min_size=1, max_size=50))
def test_node_cannot_take_longer_than_its_call(calls: list[tuple[int, float]]) -> None:
    """The peer reports it in ns; this side measures the whole call in s."""
    ledger = CallsLedger()
    for took, total in calls:
        ledger.timed(took / 1e9, total)
    ledger.tick()
    shown, longest = ledger.snapshot(), max(total for _, total in calls)
    for figure in (shown.node_p50, shown.node_p99, shown.way_p50, shown.way_p99):
        assert figure is not None
        assert 0.0 <= figure <= longest * 1.05


def test_time_in_node_and_on_way_are_whole() -> None:
    ledger = CallsLedger()
    ledger.timed(0.25, 1.0)
    ledger.tick()
    assert (ledger.node.percentiles()[0], ledger.way.percentiles()[0]) == (0.25, 0.75)


def test_the_providing_side_measures_its_node_alone() -> None:
    ledger = CallsLedger()
    ledger.timed(0.25)
    ledger.tick()
    assert (ledger.node.percentiles()[0], ledger.way.percentiles()[0]) == (0.25, None)
