"""The figures of beds that take turns: their ratios within a round."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.bed import BEDS
from bench.figures import Figures, Spread, in_turn, print_table
from bench.run import DEFAULT_BEDS, DOMAINS

if TYPE_CHECKING:
    import pytest

_HIGHEST_DOMAIN = 101


def figures_of(**values: list[float | None]) -> Figures:
    """Return the figures of some beds; None for a round without one."""
    figures = Figures()
    for bed, rounds in values.items():
        for number, value in enumerate(rounds):
            if value is not None:
                figures.add(number, bed, "CPU", value)
    return figures


def test_ratios_hold_where_a_busy_round_doubles_the_figures() -> None:
    figures = figures_of(relay=[10, 20, 40], tcp=[15, 30, 60])
    assert figures.ratio("tcp", "CPU", "relay") == Spread(1.5, 1.5, 1.5)
    assert figures.added("tcp", "CPU", "relay") == Spread(10, 5, 20)
    assert figures.spread("tcp", "CPU") == Spread(30, 15, 60)


def test_a_round_in_which_one_of_the_two_lost_messages_does_not_count() -> None:
    figures = figures_of(relay=[10, None, 10, 10], tcp=[20, 500, None, 40])
    assert figures.ratio("tcp", "CPU", "relay") == Spread(3, 2, 4)
    assert figures.added("tcp", "CPU", "relay") == Spread(20, 10, 30)


def test_without_a_common_round_there_is_no_ratio() -> None:
    figures = figures_of(relay=[10, None], tcp=[None, 20])
    assert figures.ratio("tcp", "CPU", "relay") is None
    assert figures.ratio("tcp", "CPU", "thesis") is None
    assert figures.spread("thesis", "CPU") is None


def test_a_ratio_to_nothing_is_none() -> None:
    assert figures_of(relay=[0.0], tcp=[1.0]).ratio("tcp", "CPU", "relay") is None


def test_the_search_begins_where_the_last_round_with_a_figure_ended() -> None:
    figures = figures_of(tcp=[10, 30, None])
    assert figures.latest("tcp", "CPU") == 30
    assert figures.latest("relay", "CPU") is None


def test_each_bed_is_first_once_and_none_is_left_out() -> None:
    orders = [in_turn(DEFAULT_BEDS, turn) for turn in range(len(DEFAULT_BEDS))]
    assert {order[0] for order in orders} == set(DEFAULT_BEDS)
    assert all(sorted(order) == sorted(DEFAULT_BEDS) for order in orders)


def test_each_bed_has_two_domains_of_its_own_and_one_pair_is_left_for_the_calls() -> None:
    assert len(DOMAINS) > len(BEDS)
    assert DOMAINS.step == 2
    assert DOMAINS[-1] + 1 <= _HIGHEST_DOMAIN


def test_rows_without_a_figure_and_empty_tables_are_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    figures = figures_of(relay=[10], tcp=[None])
    print_table("none", ["CPU"], ["tcp"], figures.spread, 0)
    assert capsys.readouterr().out == ""
    print_table("one", ["CPU", "faults"], ["relay", "tcp"], figures.spread, 0)
    *_, row = capsys.readouterr().out.splitlines()
    assert row.split() == ["CPU", "10", "-"]
