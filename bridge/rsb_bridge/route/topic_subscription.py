"""The subscription of a route that sends: its depth, its failures, and the histories of a latched topic."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.model.qos import auto_depth, parts_of_lease
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.ros_interface import BATCH, RosError
from rsb_bridge.route.history_depth import Histories
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.peer import TypeUse

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Hashable, Mapping, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import OnFailure, RawMessage, RouteEnds, Subscription, TopicSpec
    from rsb_bridge.route.history_depth import Bounds
    from rsb_bridge.route.lease import LeaseHalf
    from rsb_bridge.route.peer import TypeBudget
    from rsb_bridge.route.sending import OutgoingPath
    from rsb_bridge.telemetry.meters import RateMeter


_MATCHED_WITHIN = 2
"""Ticks. A round figure: DDS matches a publisher that it lists within milliseconds."""


class TopicSubscription:
    """A route's subscription, begun again with each opening. It hands all messages to `OutgoingPath`, on the I/O loop.

    With ``qos: auto`` the depth on a volatile topic follows the topic's rate. On a latched topic messages come with
    what their publishers keep for late joiners, and none that the peer has.

    Args:
        origin: messages that this node publishes under the same origin are left out.
        path: gets the messages; after `close` it drops messages that are still in the ROS queue.
        meter: of the topic's messages so far.
        found: called after the histories know more depths, or `alive` has changed.
        marks: gives the lease that messages are marked with, or None if they are not marked.
        alive_left_out: returns how many publishers may be alive that do not count, for a subscription of a QoS.

    Attributes:
        spec: the present opening's topic, with the QoS that publishers offer or an operator wants; or None before.
        histories: of a latched topic's publishers, or None for a volatile topic.
        alive: whether a publisher is alive, by the lease of its liveliness; False without a lease.
    """

    def __init__(
        self,
        context: Context,
        ends: RouteEnds,
        origin: Hashable,
        path: OutgoingPath,
        types: TypeBudget,
        meter: RateMeter,
        log: Callable[[Level, EventCode, str], None],
        found: Callable[[], None],
        marks: Callable[[], LeaseHalf | None] = lambda: None,
        alive_left_out: Callable[[Qos], int] = lambda _: 0,
    ) -> None:
        self.spec: TopicSpec | None = None
        self.histories: Histories | None = None
        self.alive = False
        self._looks_again: asyncio.TimerHandle | None = None
        self._context = context
        self._ends = ends
        self._origin = origin
        self._path = path
        self._type = TypeUse(context.ros, types)
        self._meter = meter
        self._log = log
        self._found = found
        self._marks = marks
        self._alive_left_out = alive_left_out
        self._automatic = False
        self._expected_rate: float | None = None
        self._receiver = _Receiver(path.offer)
        self._subscription: LastingSubscription | None = None
        self._depth = 0
        self._bounds: dict[bytes, Bounds] = {}  # of the depths of a latched topic's publishers
        self._lost_before = self._lost_seen = 0
        self._unmatched_ticks = 0

    # --- the subscription

    def begin(
        self, spec: TopicSpec, *, automatic: bool, expected_rate: float | None, known: Mapping[bytes, int]
    ) -> None:
        """Begin an opening. Subscribe to nothing yet.

        Args:
            automatic: whether depths are chosen here instead of by the QoS.
            expected_rate: Hz, as an operator gave it; 0 or None if not given.
            known: for each publisher of a latched topic, the number of the newest message that the peer has.
        """
        self.spec, self._automatic, self._expected_rate = spec, automatic, expected_rate
        # A new one: what is still queued for the former one is of an earlier opening, and so are the losses until now.
        self._receiver = _Receiver(self._path.offer)
        self._lost_seen = self.lost
        if spec.qos.latched:
            self.histories = Histories(
                self._context.loop,
                self._probe,
                self._path.emit,
                self._found,
                depth=0 if automatic else _kept(spec.qos),
                lifespan=spec.qos.lifespan,
                known=known,
                bounds=self._bounds,
            )

    def subscribe(self) -> None:
        """Begin to take messages.

        Raises:
            RosError: the topic cannot be subscribed to.
        """
        assert self.spec is not None
        self._type.begin(self.spec.type_name, self.spec.type_hash)
        self._subscription = LastingSubscription(self._context.loop, self._subscribe, self._changed)
        if self.spec.qos.liveliness_lease_duration:
            self._look_who_is_alive()

    def _look_who_is_alive(self) -> None:
        assert self.spec is not None
        assert self._subscription is not None
        alive = self._subscription.alive > self._alive_left_out(self.spec.qos)
        lease = self.spec.qos.liveliness_lease_duration
        self._looks_again = self._context.loop.call_later(parts_of_lease(lease), self._look_who_is_alive)
        if alive != self.alive:
            self.alive = alive
            self._found()

    def unsubscribe(self) -> None:
        """Take no more messages for now. May be called twice."""
        if self._looks_again is not None:
            self._looks_again.cancel()
            self._looks_again = None
        self.alive = False
        if self._subscription is not None:
            self._lost_before += self._subscription.lost
            self._subscription.close()
            self._subscription = None
        self._type.end()

    def close(self) -> int:
        """End the opening, drop the messages that the histories hold, and return their number."""
        self.unsubscribe()
        self._receiver.offer = self._path.too_late  # they may be older than what arms the next opening
        held = 0
        if self.histories is not None:
            self._bounds = self.histories.bounds()
            held = self.histories.close()
        self.spec = self.histories = None
        return held

    @property
    def active(self) -> bool:
        """Whether it is subscribed, or about to be again after a failure."""
        return self._subscription is not None

    @property
    def receives(self) -> bool:
        """Whether it is subscribed and has not failed."""
        return self._subscription is not None and not self._subscription.failure

    @property
    def failure(self) -> str:
        """The reason why no messages are taken now, for an operator, or an empty string."""
        return self._subscription.failure if self._subscription is not None else ""

    @property
    def lost(self) -> int:
        """Messages that DDS lost before they could be taken, over all openings."""
        return self._lost_before + (self._subscription.lost if self._subscription is not None else 0)

    @property
    def is_unmatched(self) -> bool:
        """Whether DDS has matched no publisher for a while: a listed one then differs in what the list lacks."""
        return self.receives and self._unmatched_ticks > _MATCHED_WITHIN

    def tick(self) -> None:
        """Subscribe again if DDS has lost messages that a deeper history would have kept. Called once a second."""
        if self._subscription is None:
            return
        self._unmatched_ticks = 0 if self._subscription.matched else self._unmatched_ticks + 1
        if self.lost == self._lost_seen:
            return
        self._lost_seen = self.lost
        before, depth = self._depth, self._qos().depth
        # Only then: a new subscription of a volatile topic misses what is published until DDS has matched it.
        if depth >= 2 * before:
            text = f"DDS lost messages: the subscription gets a depth of {depth:,} instead of {before:,}"
            self._log(Level.INFO, EventCode.ROUTE_DEEPENED, text)
            self._subscription.reopen()

    def _qos(self) -> Qos:
        assert self.spec is not None
        qos, meter = self.spec.qos, self._meter
        if qos.latched:
            return msgspec.structs.replace(qos, history="keep_all")  # each publisher keeps what it keeps
        if not self._automatic:
            return qos
        rate = meter.usual_rate or meter.rate or self._expected_rate or None
        return msgspec.structs.replace(qos, depth=auto_depth(rate, meter.bytes / meter.count if meter.count else 0.0))

    def _subscribe(self, on_failure: OnFailure | None) -> Subscription:
        if self.histories is not None:
            self.histories.resubscribed()
        return self._subscribe_for(self._receiver, on_failure)

    def _subscribe_for(self, receiver: _Receiver, on_failure: OnFailure | None) -> Subscription:
        assert self.spec is not None
        spec = self.spec._replace(qos=self._qos())
        self._depth = spec.qos.depth
        put = partial(self._context.ros_queue.put, receiver)
        sink: Callable[[Sequence[RawMessage]], None] = put
        if (lease := self._marks()) is not None:
            marked = Marker(lease, self._context.ros.turns, BATCH).marked

            def put_marked(batch: Sequence[RawMessage]) -> None:
                put(marked(batch))

            sink = put_marked
        return self._ends.subscribe(spec, sink, self._origin, on_failure)

    def _changed(self) -> None:
        if self.failure:
            self._log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, self.failure)
        else:
            text = f"subscribed again ({self.spec.type_name if self.spec is not None else ''})"
            self._log(Level.INFO, EventCode.ROUTE_CONNECTED, text)

    def _probe(self, take: Callable[[Sequence[RawMessage]], None]) -> Subscription:
        if self._subscription is None:
            raise RosError("the topic is not subscribed to")
        return self._subscribe_for(_Receiver(take), None)


class _Receiver:
    """A receiver of the ROS queue that may change the function that gets the messages."""

    def __init__(self, offer: Callable[[Sequence[RawMessage]], None]) -> None:
        self.offer = offer


def _kept(qos: Qos) -> int:
    return LATCHED_DEPTH if qos.history == "keep_all" else max(1, qos.depth)
