"""Limits on the velocity that a hand may ask: the smallest of several, and what they leave."""

from __future__ import annotations

import pytest

from rsb_bridge.model.by_hand import VelocityLimits, smallest_limits


def limits(linear: float | None = None, angular: float | None = None) -> VelocityLimits:
    return VelocityLimits(linear, angular)


@pytest.mark.parametrize(
    ("several", "whole"),
    [
        ([], None),
        ([None, None], None),
        ([limits(0.5, 1), None], limits(0.5, 1)),
        ([limits(0.5, 1), limits(0.8, 0.3)], limits(0.5, 0.3)),
        ([limits(0.5), limits(angular=0.3)], limits(0.5, 0.3)),
    ],
)
def test_the_smallest_number_of_each_kind_counts(
    several: list[VelocityLimits | None], whole: VelocityLimits | None
) -> None:
    assert smallest_limits(several) == whole


def test_line_counts_if_one_of_its_numbers_does() -> None:
    whole = limits(0.5, 0.3)
    assert limits(0.5, 1).are_in(whole)
    assert limits(angular=0.3).are_in(whole)
    assert not limits(0.6, 1).are_in(whole)
    assert not limits(0.6).are_in(limits(angular=1))


def test_each_direction_has_the_same_limit() -> None:
    assert limits(0.5, 1).reduced(-0.8, -2) == (-0.5, -1)
    assert limits(0.5, 1).reduced(0.8, 0.2) == (0.5, 0.2)
    assert limits(angular=1).reduced(7, 2) == (7, 1)
    assert str(limits(0.5, 1)) == "0.5 m/s, 1 rad/s"
