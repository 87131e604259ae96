"""Taking a topic's messages from ROS, for a route that sends them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.model.qos import auto_depth
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.ros_interface import BATCH, RosError
from rsb_bridge.route.history_depth import Histories
from rsb_bridge.route.lease import Marker

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Mapping, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import OnFailure, RawMessage, Subscription
    from rsb_bridge.ros.ros_thread import Receiver
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.lease import Lease
    from rsb_bridge.telemetry.meters import RateMeter


class TopicSubscriptionOwner(Protocol):
    """Who the messages are taken for.

    Attributes:
        meter: how many there were so far.
    """

    meter: RateMeter

    def admit(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """The messages to take now; of the others, some may come later, by `TopicSubscription.take`."""
        ...

    def offer(self, batch: Sequence[RawMessage]) -> None:
        """Take messages of a volatile topic, oldest first."""
        ...

    def offer_latched(self, new: int, samples: Sequence[Sample]) -> None:
        """Take messages of a latched topic, of which `new` are new; of those that wait, some may come now."""
        ...

    def too_late(self, messages: int) -> None:
        """So many messages have come after the end of their opening."""
        ...

    def log_intake(self, level: Level, code: EventCode, text: str) -> None:
        """Add an event about the subscription."""
        ...


class SubscriptionSpec(NamedTuple):
    """What is subscribed to.

    Attributes:
        topic: its name.
        type_name: of its type.
        type_hash: of its type.
        qos: as its publishers offer, or as an operator wants it.
        origin: what this node publishes under the same origin is left out.
    """

    topic: str
    type_name: str
    type_hash: str
    qos: Qos
    origin: Hashable


class TopicSubscription:
    """A route's subscription, for one opening.

    With ``qos: auto`` the depth on a volatile topic follows the topic's rate. On a latched topic messages come with
    what their publishers keep for late joiners, and none that the peer has.
    """

    def __init__(
        self,
        context: Context,
        owner: TopicSubscriptionOwner,
        subject: SubscriptionSpec,
        *,
        automatic: bool,
        expected_rate: float | None,
        known: Mapping[bytes, int],
        marks: Callable[[], Lease | None] = lambda: None,
    ) -> None:
        """Have nothing subscribed yet.

        Args:
            context: what every part of the engine shares.
            owner: gets the messages, on the I/O loop.
            subject: what to subscribe to.
            automatic: whether depths are chosen here; False: they are as in the QoS.
            expected_rate: Hz, as an operator gave it; 0 or None: not given.
            known: of a latched topic's publishers, the number of the newest message that the peer has.
            marks: gives the lease that messages are marked with, or None if they need not be.
        """
        self._context = context
        self._owner = owner
        self._subject = subject
        self._automatic = automatic
        self._expected_rate = expected_rate
        self._marks = marks
        self._subscription: LastingSubscription | None = None
        self._histories: Histories | None = None
        if subject.qos.latched:
            self._histories = Histories(
                context.loop, self._probe, self._emit, depth=0 if automatic else _kept(subject.qos), known=known
            )
        self._depth = 0
        self._lost_before = self._lost_seen = 0
        self._closed = False

    # --- the subscription

    def subscribe(self) -> None:
        """Begin to take messages.

        Raises:
            RosError: the topic cannot be subscribed to.
        """
        self._subscription = LastingSubscription(self._context.loop, self._subscribe, self._changed)

    def unsubscribe(self) -> None:
        """Take no more messages for now. May be called twice."""
        if self._subscription is not None:
            self._lost_before += self._subscription.lost
            self._subscription.close()
            self._subscription = None

    def close(self) -> int:
        """Take no more messages, and give out none that waits.

        Returns:
            How many waited.
        """
        self.unsubscribe()
        self._closed = True
        return self._histories.close() if self._histories is not None else 0

    @property
    def active(self) -> bool:
        """Whether it is subscribed, or about to be again after a failure."""
        return self._subscription is not None

    @property
    def failure(self) -> str:
        """Why no messages are taken now, as an operator reads it; empty: there was no failure."""
        return self._subscription.failure if self._subscription is not None else ""

    @property
    def lost(self) -> int:
        """Messages that DDS lost before they could be taken."""
        return self._lost_before + (self._subscription.lost if self._subscription is not None else 0)

    def tick(self) -> None:
        """Once a second: subscribe anew, where DDS has lost messages that a deeper history would have kept."""
        if self._subscription is None or self.lost == self._lost_seen:
            return
        self._lost_seen = self.lost
        before, depth = self._depth, self._qos().depth
        if depth >= 2 * before:
            text = f"DDS lost messages: the subscription gets a depth of {depth:,} instead of {before:,}"
            self._owner.log_intake(Level.INFO, EventCode.ROUTE_DEEPENED, text)
            self._subscription.reopen()

    def look(self, publishers: Collection[bytes]) -> None:
        """Note which publishers the graph has, by their ids."""
        if self._histories is not None:
            self._histories.look(publishers)

    def _qos(self) -> Qos:
        qos, meter = self._subject.qos, self._owner.meter
        if qos.latched:
            return msgspec.structs.replace(qos, history="keep_all")  # each publisher keeps what it keeps
        if not self._automatic:
            return qos
        rate = meter.usual_rate or meter.rate or self._expected_rate or None
        return msgspec.structs.replace(qos, depth=auto_depth(rate, meter.bytes / meter.count if meter.count else 0.0))

    def _subscribe(self, on_failure: OnFailure | None) -> Subscription:
        if self._histories is not None:
            self._histories.resubscribed()
        return self._subscribe_for(self, on_failure)

    def _subscribe_for(self, receiver: Receiver[RawMessage], on_failure: OnFailure | None) -> Subscription:
        subject, qos = self._subject, self._qos()
        self._depth = qos.depth
        context, lease = self._context, self._marks()

        def put(batch: Sequence[RawMessage]) -> None:
            context.ros_queue.put(receiver, batch)

        def put_marked(batch: Sequence[RawMessage]) -> None:
            put(marker.marked(batch))

        sink = put
        if lease is not None:
            marker, sink = Marker(lease, context.ros.turns, BATCH), put_marked
        return self._context.ros.subscribe(
            subject.topic,
            subject.type_name,
            subject.type_hash,
            qos,
            sink,
            subject.origin,
            on_failure,
        )

    def _changed(self) -> None:
        if self.failure:
            self._owner.log_intake(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, self.failure)
        else:
            text = f"subscribed again ({self._subject.type_name})"
            self._owner.log_intake(Level.INFO, EventCode.ROUTE_CONNECTED, text)

    # --- messages, on the I/O loop

    def offer(self, batch: Sequence[RawMessage]) -> None:
        """Take messages from ROS, oldest first."""
        if self._closed:  # they were on their way here, and may be older than what arms the next opening
            self._owner.too_late(len(batch))
        else:
            self.take(self._owner.admit(batch))

    def take(self, batch: Sequence[RawMessage]) -> None:
        """Take messages that have been admitted."""
        if self._histories is None:
            self._owner.offer(batch)
        else:
            self._owner.offer_latched(self._histories.take(batch), ())

    def _emit(self, samples: Sequence[Sample]) -> None:
        self._owner.offer_latched(0, samples)

    def _probe(self, take: Callable[[Sequence[RawMessage]], None]) -> Subscription:
        if self._subscription is None:
            raise RosError(f"{self._subject.topic} is not subscribed to")
        return self._subscribe_for(_Receiver(take), None)


class _Receiver:
    def __init__(self, take: Callable[[Sequence[RawMessage]], None]) -> None:
        self.offer = take


def _kept(qos: Qos) -> int:
    return LATCHED_DEPTH if qos.history == "keep_all" else max(1, qos.depth)
