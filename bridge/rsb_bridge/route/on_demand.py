"""Leaves messages in DDS that a full link would have this side drop: the newest is taken when the topic's turn comes.

To take, copy, queue and drop an image costs as much as to send it, but for the link. So where most messages of a topic
are dropped from its queue, a subscription that keeps one message takes the place of the route's. The numbers that DDS
gives to publications tell how many were left: they count as dropped, under `NOT_TAKEN`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.route.ledger import NOT_TAKEN, QUEUE_FULL
from rsb_bridge.route.route import promised_keep

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.sending import OutgoingPath
    from rsb_bridge.route.topic_flow import TopicFlow
    from rsb_bridge.route.topic_subscription import TopicSubscription

# Round figures: a subscription that takes another one's place misses what is published until DDS has matched it.
_BEGINS_AFTER, _ENDS_AFTER = 3, 10
"""Seconds in a row in which most messages are left out, and in which no more than half are."""


class OnDemand:
    """Decides whether a best-effort topic's messages are taken on demand, and asks for them."""

    def __init__(self, flow: TopicFlow, path: OutgoingPath, subscription: TopicSubscription) -> None:
        self._route, self._flow, self._carried = flow.route, flow, flow.carried
        self._path, self._subscription = path, subscription
        self._offered = self._left_out = 0  # as of the last tick
        self._unasked = 0  # of these the ledger knows
        self._seconds = 0  # in a row in which more, or fewer, were left out than as long as it stays as it is
        self._has_turned = False

    def turn(self) -> None:
        """Take the newest messages, as the route's turn has come, and have it get another turn if there are any."""
        demand, channel = self._subscription.demand, self._carried.channel
        if demand is None or channel is None:
            return
        self._has_turned = True
        if taken := demand.newest():
            self._offer(taken)

    def tick(self, now: float) -> None:
        """Look whether it is to begin or to end. Called once a second, once any message has been dropped."""
        subscription, demand = self._subscription, self._subscription.demand
        is_on = demand is not None
        if demand is not None and not self._has_turned:
            # So that a topic with one turn a minute is not taken for silent. On a busy machine, a large message takes
            # 0.1 s to take, for which the loop need not wait.
            demand.await_next()
        self._has_turned = False
        self._count(now)
        ledger = self._path.ledger
        left_out = ledger.dropped[QUEUE_FULL] + ledger.dropped[NOT_TAKEN]
        offered, left_out_now = ledger.offered - self._offered, left_out - self._left_out
        self._offered, self._left_out = ledger.offered, left_out
        changes = (2 * left_out_now > offered) is not is_on
        self._seconds = self._seconds + 1 if changes else 0
        if is_on and (self._seconds >= _ENDS_AFTER or not self._may_leave_out):
            self._seconds = 0
            subscription.take_on_demand(None)
        elif not is_on and self._seconds >= _BEGINS_AFTER and self._may_leave_out and self._is_behind(now):
            self._seconds = 0
            subscription.take_on_demand(self._offer)

    def _offer(self, taken: Sequence[RawMessage]) -> None:
        self._count(self._route.context.now())
        self._path.offer(taken)
        if (channel := self._carried.channel) is not None and channel.ready:
            channel.ask()

    def _count(self, now: float) -> None:
        """Have the ledger know of the messages that were left."""
        unasked = self._subscription.numbers.counts[Untaken.UNASKED]
        if count := unasked - self._unasked:
            self._unasked = unasked
            self._path.leave_out(count, now)

    def _is_behind(self, now: float) -> bool:
        channel = self._carried.channel
        return channel is not None and channel.ready and channel.behind(now)

    @property
    def _may_leave_out(self) -> bool:
        """Whether nobody wants the messages that are left, and DDS numbers them."""
        route, spec, numbers = self._route, self._subscription.spec, self._subscription.numbers.newest
        return (
            spec is not None and spec.qos.reliability == "best_effort" and not spec.qos.latched
            and route.proposal.qos is None and not route.proposal.express and promised_keep(route) is None
            and not route.arming.required and not route.age.only_newest and not route.limit.rate
            and self._flow.peek_slot.tap is None and self._subscription.receives and all([*numbers.values()])
        )  # fmt: skip
