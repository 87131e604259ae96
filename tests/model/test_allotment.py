"""Division of a link: the highest priority first, and everybody gets something."""

from __future__ import annotations

from random import Random

import pytest

from rsb_bridge.model.link_budget import FLOOR, Wish, allot, fair_shares


def test_there_is_enough_for_all() -> None:
    wishes = {"a": Wish(1, 100.0), "b": Wish(0, 200.0), "c": Wish(-1, 300.0)}
    assert allot(600.0, wishes) == {"a": 100.0, "b": 200.0, "c": 300.0}


def test_the_lowest_yields_first() -> None:
    wishes = {"scan": Wish(1, 100.0), "map": Wish(0, 200.0), "camera": Wish(-1, 3000.0)}
    assert allot(1000.0, wishes) == {"scan": 100.0, "map": 200.0, "camera": 700.0}


def test_each_lower_priority_keeps_a_twentieth() -> None:
    wishes = {"scan": Wish(1, 5000.0), "map": Wish(0, 200.0), "camera": Wish(-1, 3000.0)}
    assert allot(1000.0, wishes) == {"scan": 900.0, "map": 50.0, "camera": 50.0}


def test_equals_share_equally_after_those_who_want_less() -> None:
    assert fair_shares(90.0, {"a": 100.0, "b": 10.0, "c": 50.0}) == {"b": 10.0, "c": 40.0, "a": 40.0}


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_wanted(seed: int) -> None:
    """No more than the link carries, nobody more than wanted, and each priority its floor."""
    random = Random(seed)
    wishes = {number: Wish(random.randint(-1, 1), random.uniform(0.0, 1e6)) for number in range(random.randint(1, 9))}
    capacity = random.uniform(1.0, 3e6)
    shares = allot(capacity, wishes)
    assert sum(shares.values()) <= capacity * 1.000001
    assert all(0.0 <= shares[key] <= wish.bytes_per_second for key, wish in wishes.items())
    for rank in {wish.rank for wish in wishes.values()}:
        wanted = sum(wish.bytes_per_second for wish in wishes.values() if wish.rank == rank)
        had = sum(shares[key] for key, wish in wishes.items() if wish.rank == rank)
        assert had >= min(wanted, FLOOR * capacity) * 0.999999
