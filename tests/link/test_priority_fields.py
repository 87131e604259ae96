"""Priorities are proposed and changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.link.proposals import amended, amended_topic, amendment, proposal_of, same_route
from rsb_bridge.model.session import HIGHEST, Topic, priority_of
from rsb_bridge.route.rate_limit import limits_changed
from rsb_bridge.route.route import rank_of
from rsb_bridge.transport.registry import default_transports

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import Propose


def proposal(topic: Topic) -> Propose:
    return proposal_of(topic, default_transports()["tcp"], client_name="robot1", use_name=False)


def test_a_newer_side_s_ranks_count_as_the_nearest_word() -> None:
    """Else each of them would keep a part of the link, until nothing is left for the highest."""
    proposed = proposal(Topic("/scan", "transmit"))
    ranks = [rank_of(msgspec.structs.replace(proposed, priority=rank), armed=False) for rank in range(-100, 101)]
    assert ranks == [-1] * 100 + [0] + [1] * 100
    assert [priority_of(rank) for rank in (-100, -1, 0, 1, 100)] == ["low", "low", "normal", "high", "high"]
    assert rank_of(proposal(Topic("/cmd_vel", "transmit", priority="low")), armed=True) == HIGHEST


def test_it_changes_while_the_route_is_open() -> None:
    normal, low = (proposal(Topic("/scan", "transmit", priority=each)) for each in ("normal", "low"))
    assert same_route(normal, low)
    assert "priority" in limits_changed(normal, low)
    assert amended_topic(Topic("/scan", "transmit"), amended(normal, amendment(low, 1))).priority == "low"
