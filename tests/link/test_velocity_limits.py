"""Limits on what a hand may ask: agreed when a route opens, the smaller number of the two sessions counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.link.arming_helpers import propose, route
from tests.link.route_table_helpers import Pair, hear_all, pair_of

from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.demands import PEER_DEMANDS, OriginText
from rsb_bridge.model.session import ArmedName, Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context

HERE = OriginText.THIS_SESSION()
Lines = tuple[str, ...]


def pair_with(make_context: Callable[..., Context], robots: VelocityLimits | None, pcs: VelocityLimits | None) -> Pair:
    armed = () if pcs is None else (ArmedName("/cmd_vel", limits=pcs),)
    pair = robot, _ = pair_of(make_context(), make_context(role="server", armed=armed))
    propose(robot, Topic("/cmd_vel", "receive", limits=robots))
    hear_all(pair)
    return pair


@pytest.mark.parametrize(
    ("robots", "pcs", "whole", "at_the_robot", "at_the_pc"),
    [
        (None, None, None, (), ()),
        (VelocityLimits(0.5), None, VelocityLimits(0.5), (HERE,), (PEER_DEMANDS,)),
        (None, VelocityLimits(0.5), VelocityLimits(0.5), (PEER_DEMANDS,), (HERE,)),
        (VelocityLimits(0.5), VelocityLimits(0.8, 1), VelocityLimits(0.5, 1), (HERE, PEER_DEMANDS), None),
        (VelocityLimits(0.5, 2), VelocityLimits(0.4, 1), VelocityLimits(0.4, 1), (PEER_DEMANDS,), (HERE,)),
        (VelocityLimits(0.5), VelocityLimits(0.5), VelocityLimits(0.5), (HERE, PEER_DEMANDS), None),
    ],
)
def test_either_session_sets_limits_known_to_both(
    robots: VelocityLimits | None,
    pcs: VelocityLimits | None,
    whole: VelocityLimits | None,
    at_the_robot: Lines,
    at_the_pc: Lines | None,
    make_context: Callable[..., Context],
) -> None:
    shown = [route(side).snapshot() for side in pair_with(make_context, robots, pcs)]
    assert [each.limits for each in shown] == [whole, whole]
    assert [each.limited_by for each in shown] == [at_the_robot, at_the_robot if at_the_pc is None else at_the_pc]


def test_they_change_with_the_session_of_either_side(make_context: Callable[..., Context]) -> None:
    """Also while the route is open."""
    robot, pc = pair_with(make_context, VelocityLimits(0.5), VelocityLimits(0.4))
    assert route(robot).arming.limits == VelocityLimits(0.4)
    armed = (ArmedName("/cmd_vel", limits=VelocityLimits(0.3)),)
    pc.context.demands.use(msgspec.structs.replace(pc.context.session, armed=armed))
    pc.context.demands.apply()
    hear_all((robot, pc))
    robot.table.retry()
    hear_all((robot, pc))
    assert [route(side).arming.limits for side in (robot, pc)] == [VelocityLimits(0.3)] * 2
