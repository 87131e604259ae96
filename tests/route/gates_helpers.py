"""Helpers of `test_gates` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_thread import RosTurns
from rsb_bridge.route.lease import LeaseHalf

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.route.arming import Arming


def leased(arming: Arming, context: Context) -> LeaseHalf:
    """Give an arming a lease that both sides have answered."""
    lease = arming.lease = LeaseHalf(context.clock.steady, RosTurns(), lambda: None)
    lease.begin()
    for newest in range(1, 3):  # the second shows that the other side knows that it is heard
        lease.hear(newest, lease.beat()[0])
    return lease


def armed(arming: Arming, context: Context) -> LeaseHalf:
    """Arm by the other side; return the lease, which both sides have answered."""
    arming.opened(required=True, deadman=0.0)
    lease = leased(arming, context)
    arming.arm_for_peer("anna", context.now())
    arming.lives()
    return lease
