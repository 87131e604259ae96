"""Division of a link by the weights of priorities, as its scheduler does."""

from __future__ import annotations

from random import Random

import pytest

from rsb_bridge.model.link_budget import TopicDemand, allot
from rsb_bridge.model.session import weight_of


def test_those_that_want_more_share_by_weight() -> None:
    wishes = {
        "scan": TopicDemand(1, 100.0),
        "map": TopicDemand(0, 9000.0),
        "camera": TopicDemand(-1, 9000.0),
        "points": TopicDemand(-1, 9000.0),
    }
    weights = weight_of(0) + 2 * weight_of(-1)
    shares = allot(1000.0, wishes)
    assert shares["scan"] == 100.0
    assert shares["map"] == pytest.approx(900.0 * weight_of(0) / weights)
    assert shares["camera"] == shares["points"] == pytest.approx(900.0 * weight_of(-1) / weights)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_wanted(seed: int) -> None:
    """No topic gets more than it wants, and one that gets less has at least its part of the link."""
    random = Random(seed)
    wishes = {
        number: TopicDemand(random.randint(-1, 1), random.uniform(0.0, 1e6)) for number in range(random.randint(1, 9))
    }
    capacity = random.uniform(1.0, 3e6)
    shares = allot(capacity, wishes)
    wanted = sum(wish.bytes_per_second for wish in wishes.values())
    assert sum(shares.values()) == pytest.approx(min(capacity, wanted))
    weights = sum(weight_of(wish.rank) for wish in wishes.values())
    for key, wish in wishes.items():
        part = capacity * weight_of(wish.rank) / weights
        assert min(wish.bytes_per_second, part) * 0.999999 <= shares[key] <= wish.bytes_per_second
