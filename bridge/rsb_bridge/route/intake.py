"""Taking a topic's messages from ROS, for a route that sends them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import auto_depth
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.lasting_subscription import LastingSubscription

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.api import OnFailure, Subscription
    from rsb_bridge.ros.queue import Receiver
    from rsb_bridge.telemetry.meters import RateMeter
    from rsb_bridge.wire.messages import Describe

    Log = Callable[[Level, EventCode, str], None]


class Intake:
    """A route's subscription. With ``qos: auto`` on a volatile topic its depth follows the topic's rate.

    Attributes:
        failure: why no messages are taken now, as an operator reads it; empty: they are.
    """

    def __init__(
        self,
        context: Context,
        receiver: Receiver,
        topic: str,
        described: Describe,
        origin: Hashable,
        *,
        log: Log,
        rates: RateMeter | None,
        expected_rate: float | None,
    ) -> None:
        """Subscribe.

        Args:
            context: what every part of the engine shares.
            receiver: gets the messages, on the I/O loop.
            topic: its name.
            described: its type and QoS.
            origin: what this node publishes under the same origin is left out.
            log: adds an event about the route.
            rates: of the topic so far, to choose the depth by; None: the depth is as described.
            expected_rate: Hz, as an operator gave it; 0 or None: not given.

        Raises:
            RosError: the topic cannot be subscribed to.
        """
        self._context = context
        self._receiver = receiver
        self._topic = topic
        self._described = described
        self._origin = origin
        self._log = log
        self._rates = rates
        self._expected_rate = expected_rate
        self._depth = 0
        self._lost_seen = 0
        self._subscription = LastingSubscription(context.loop, self._subscribe, self._changed)

    @property
    def failure(self) -> str:
        return self._subscription.failure

    @property
    def lost(self) -> int:
        """Messages that DDS lost before they could be taken."""
        return self._subscription.lost

    def close(self) -> None:
        """Take no more messages."""
        self._subscription.close()

    def tick(self) -> None:
        """Once a second: subscribe anew, where DDS has lost messages that a deeper history would have kept."""
        if self.lost == self._lost_seen:
            return
        self._lost_seen = self.lost
        before, depth = self._depth, self._qos().depth
        if depth >= 2 * before:
            text = f"DDS lost messages: the subscription gets a depth of {depth:,} instead of {before:,}"
            self._log(Level.INFO, EventCode.ROUTE_DEEPENED, text)
            self._subscription.reopen()

    def _qos(self) -> Qos:
        qos, rates = self._described.qos, self._rates
        if rates is None:
            return qos
        rate = rates.usual_rate or rates.rate or self._expected_rate or None
        mean_size = rates.bytes / rates.count if rates.count else 0.0
        return msgspec.structs.replace(qos, depth=auto_depth(rate, mean_size))

    def _subscribe(self, on_failure: OnFailure) -> Subscription:
        qos = self._qos()
        self._depth = qos.depth
        return self._context.ros.subscribe(
            self._topic,
            self._described.type,
            self._described.type_hash,
            qos,
            lambda batch: self._context.ros_queue.put(self._receiver, batch),
            self._origin,
            on_failure,
        )

    def _changed(self) -> None:
        if self.failure:
            self._log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, self.failure)
        else:
            self._log(Level.INFO, EventCode.ROUTE_CONNECTED, f"subscribed again ({self._described.type})")
