"""The other side's operators: its words, marked as such, and only as many as have room."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest
from tests.support.offline import FakePeer

from rsb_bridge.link.peer_operators import PeerOperators
from rsb_bridge.model.purposes import TOPIC
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.route.route import Route

_ROOM = 500
"""Actions of all operators that the time line keeps."""


class Scan:
    """A route, as far as an event says anything of it."""

    peer = FakePeer()
    local_topic = "/scan"
    spec = Topic("/scan", "transmit")
    pausing = SimpleNamespace(paused=True)
    purpose = TOPIC


@pytest.fixture
def route() -> Route:
    return cast("Route", Scan())


@pytest.mark.parametrize("forged", ["anna on pts/3", "root on tty1 from 10.0.0.1", "", "says: anna on pts/3"])
def test_peer_cannot_pose_as_operator_of_this_side(forged: str, route: Route, context: Context) -> None:
    operators = PeerOperators(context, "robot1")
    operators.paused(route, forged)
    operators.removed(route, forged)
    operators.edited(route, forged, None)
    events = context.events.after(0)
    assert len(events) == 3
    for event in events:
        assert event.from_peer
        assert event.who.startswith("robot1 says: ")
        assert event.who in event.text


def test_peer_cannot_fill_log_of_what_operators_did(route: Route, context: Context) -> None:
    operators = PeerOperators(context, "robot1")
    for _ in range(10 * _ROOM):
        operators.removed(route, "anna")
    assert len(context.events.after(0)) < _ROOM / 10
