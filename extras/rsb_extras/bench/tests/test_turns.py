"""The figures of beds that take turns: their ratios within a round."""

from __future__ import annotations

from bench.figures import Figures, Spread, in_turn
from bench.run import DEFAULT_BEDS


def figures_of(**values: list[float | None]) -> Figures:
    """Return the figures of some beds; None for a round without one."""
    figures = Figures()
    for bed, rounds in values.items():
        for number, value in enumerate(rounds):
            if value is not None:
                figures.add(number, bed, "CPU", value)
    return figures


def test_ratios_hold_where_busy_round_doubles_figures() -> None:
    figures = figures_of(relay=[10, 20, 40], tcp=[15, 30, 60])
    assert figures.ratio("tcp", "CPU", "relay") == Spread(1.5, 1.5, 1.5)
    assert figures.added("tcp", "CPU", "relay") == Spread(10, 5, 20)
    assert figures.spread("tcp", "CPU") == Spread(30, 15, 60)


def test_round_with_one_lost_message_does_not_count() -> None:
    figures = figures_of(relay=[10, None, 10, 10], tcp=[20, 500, None, 40])
    assert figures.ratio("tcp", "CPU", "relay") == Spread(3, 2, 4)
    assert figures.added("tcp", "CPU", "relay") == Spread(20, 10, 30)


def test_each_bed_is_first_once() -> None:
    orders = [in_turn(DEFAULT_BEDS, turn) for turn in range(len(DEFAULT_BEDS))]
    assert {order[0] for order in orders} == set(DEFAULT_BEDS)
    assert all(sorted(order) == sorted(DEFAULT_BEDS) for order in orders)
