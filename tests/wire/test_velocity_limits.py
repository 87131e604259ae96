"""Limits on what a hand may ask, in a proposal and its acceptance."""

from __future__ import annotations

import msgspec
import pytest

from rsb_bridge.model.velocity_limits import VelocityLimits
from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.messages import Accept, Propose
from rsb_bridge.wire.protocol_error import ProtocolError


@pytest.mark.parametrize("limits", [{"linear": 0}, {"angular": -1.0}, {"linear": float("nan")}, {"linear": 1e9}])
def test_a_peer_that_sets_impossible_ones_breaks_the_protocol(limits: dict[str, float]) -> None:
    accept = {"message": "accept", "route": 1, "topic": "/cmd_vel"}
    for message in (accept, accept | {"message": "propose", "remote_topic": "/cmd_vel", "from_client": True}):
        with pytest.raises(ProtocolError):
            decode(msgspec.msgpack.encode(message | {"limits": limits}))


def test_those_of_a_newer_peer_may_have_more_numbers() -> None:
    message = {"message": "accept", "route": 1, "topic": "/cmd_vel", "limits": {"linear": 0.5, "jerk": 3.0}}
    accept = decode(msgspec.msgpack.encode(message))
    assert isinstance(accept, Accept)
    assert accept.limits == VelocityLimits(0.5)
    proposal = Propose(route=1, topic="/a", remote_topic="/a", from_client=True, limits=VelocityLimits(angular=2.0))
    assert decode(encode(proposal)) == proposal
