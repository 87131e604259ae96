"""Renewed topics: the sending side subscribes again when more subscribe on the receiving side (``renew``).

Some publishers send everything to a new subscriber: a costmap, or an encoder its next key frame. They see only the
bridge's subscription. So it goes and comes back for subscribers on the far side, which they cannot see.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    import asyncio

    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_subscription import TopicSubscription

APART = 2.0  # s between two renewals at the least: nodes that start together cost one or two


class Renewal:
    """Renews a sending half's subscription."""

    def __init__(self, route: Route, subscription: TopicSubscription) -> None:
        self._route, self._subscription = route, subscription
        self._count = 0
        self._renewed_at = float("-inf")
        self._timer: asyncio.TimerHandle | None = None

    def told(self, subscribers: int, *, rests: bool) -> None:
        """Take the number of subscriptions that DDS has matched on the other side.

        Args:
            rests: whether the topic rests, so that the subscription which follows is a new one anyway.
        """
        before, self._count = self._count, subscribers
        if subscribers > before and self._route.proposal.renew and not rests and self._timer is None:
            loop = self._route.context.loop
            self._timer = loop.call_at(max(loop.time(), self._renewed_at + APART), self._renew)

    def _renew(self) -> None:
        self._timer = None
        if not self._subscription.receives:
            return
        self._renewed_at = self._route.context.now()
        self._subscription.renew()
        text = f"subscribed anew: {self._count} subscribe to {self._route.far_topic} there"
        self._route.log(Level.INFO, EventCode.ROUTE_RENEWED, text)

    def end(self) -> None:
        """End the opening."""
        self._count = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
