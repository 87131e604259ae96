"""What the publishers of a route are created with, whatever the peer asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.limits import KEPT_DEPTH, LATCHED_DEPTH

if TYPE_CHECKING:
    from rsb_bridge.model.qos import Qos

AUTO_DEPTH = 10
"""Messages, where the QoS names no number."""


def bounded(qos: Qos) -> Qos:
    """Return a QoS with what a publisher here keeps at most for late joiners and slow readers."""
    if not qos.latched:
        return msgspec.structs.replace(qos, depth=min(qos.depth, KEPT_DEPTH))
    depth = LATCHED_DEPTH if qos.history == "keep_all" else min(max(qos.depth, 1), LATCHED_DEPTH)
    return msgspec.structs.replace(qos, history="keep_last", depth=depth)


def without_history(qos: Qos) -> Qos:
    """A QoS without what late joiners get: a command that is older than the arming is nobody's."""
    return msgspec.structs.replace(qos, durability="volatile") if qos.latched else qos
