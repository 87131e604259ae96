"""Lazy topics: the sending side subscribes only while somebody on the receiving side wants the messages (``lazy``).

A camera that encodes only while somebody listens then rests, and nothing crosses for nobody. The receiving side reports
its subscriptions anyway (`rsb_bridge.route.listeners`), and at once if they change.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.listeners import no_subscriber

if TYPE_CHECKING:
    import asyncio

    from rsb_bridge.context import Context
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.source_publishers import SourcePublishers
    from rsb_bridge.route.topic_flow import TopicFlow

KEPT_FOR = 5.0  # s for which a subscription stays that nobody wants: a node that starts again finds it
HEAVY_TYPES = frozenset(
    {
        "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "stereo_msgs/msg/DisparityImage",
        "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointCloud", "theora_image_transport/msg/Packet",
        "ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "foxglove_msgs/msg/CompressedVideo",
        "point_cloud_interfaces/msg/CompressedPointCloud2",
    }
)  # fmt: skip
"""Images and point clouds, for links whose profile makes them lazy."""
# Of a graph that has changed. Both are round figures: DDS matches endpoints within milliseconds of discovering them.
_LOOKS_EVERY, _LOOKS_FOR = 0.05, 3.0


class LazySender:
    """Decides whether a sending half may do without its subscription.

    Attributes:
        rests: whether nobody has wanted the messages for a while, of a topic that may rest.
    """

    def __init__(self, route: Route, flow: TopicFlow) -> None:
        self._route, self._flow = route, flow
        self._wanted_there = False
        self._until = -math.inf  # s: until then it is subscribed to, wanted or not
        self.rests = False
        flow.peek_slot.changed = self.look

    @property
    def _may_rest(self) -> bool:
        route, flow = self._route, self._flow
        lazy = route.proposal.lazy
        if lazy is None:
            lazy = route.peer.profile.lazy and flow.type_name in HEAVY_TYPES
        kept = flow.is_latched or route.proposal.keep is not None or route.arming.required
        return lazy and not kept and route.purpose.in_graph

    @property
    def _is_wanted(self) -> bool:
        return bool(self._flow.audience.count) or self._wanted_there or self._flow.peek_slot.wanted

    def told(self, *, wanted: bool) -> None:
        """Take whether the other side's bridge wants the messages itself."""
        self._wanted_there = wanted
        self.look()

    def look(self) -> None:
        """Rest, or go on, by who wants the messages now."""
        route = self._route
        self._look_who_wants()
        rests = self._may_rest and not self._is_wanted and route.context.now() >= self._until
        if rests == self.rests or not route.id:
            return
        self.rests = rests
        if rests:
            text = f"rests: {no_subscriber(route.far_topic, None)}"
            route.log(Level.INFO, EventCode.ROUTE_RESTING, text, cause=Cause.RESTING)
        route.half.restart_measuring()
        route.judge_again()
        route.advance()
        route.peer.report_soon(route)

    def end(self) -> None:
        """End the opening. The next one subscribes at once if the messages were wanted until now."""
        self._wanted_there = self.rests = False
        self._look_who_wants()

    def _look_who_wants(self) -> None:
        context = self._route.context
        if self._is_wanted:
            self._until = math.inf
        elif self._until == math.inf:
            self._until = context.now() + KEPT_FOR
            context.loop.call_at(self._until, self.look)


class Looker(Protocol):
    """A receiving half whose sender rests."""

    def look(self) -> None:
        """Look whether somebody wants the messages now."""


class AwaitedListeners:
    """Looks for listeners of topics that rest as soon as the graph changes, and more often than routes look at it."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._waiting: dict[Looker, None] = {}
        self._until = -math.inf
        self._timer: asyncio.TimerHandle | None = None

    def add(self, looker: Looker) -> None:
        self._waiting[looker] = None

    def discard(self, looker: Looker) -> None:
        self._waiting.pop(looker, None)

    def graph_changed(self) -> None:
        """Look now, and for some seconds: DDS matches an endpoint after it has shown it."""
        self._until = self._context.now() + _LOOKS_FOR
        if self._waiting and self._timer is None:
            self._look()

    def _look(self) -> None:
        self._timer = None
        for looker in tuple(self._waiting):
            looker.look()
        if self._waiting and self._context.now() < self._until:
            self._timer = self._context.loop.call_later(_LOOKS_EVERY, self._look)


class LazyReceiver:
    """Tells the sending side whether anybody wants the messages, at once if that changes."""

    def __init__(self, route: Route, flow: TopicFlow, outputs: SourcePublishers) -> None:
        self._route, self._flow, self._outputs = route, flow, outputs
        self._awaited = route.context.shared(AwaitedListeners)
        self._told = 0, False
        flow.peek_slot.changed = self._peeked

    @property
    def rests(self) -> bool:
        """Whether the sending side rests, and nobody here wants the messages."""
        return self._route.judged.peer.cause == Cause.RESTING and not self._flow.audience.count and not self.wanted

    @property
    def wanted(self) -> bool:
        """Whether this bridge takes the messages itself: for another link, an operator or a recording."""
        route, now = self._route, self._route.context.now()
        return route.purpose.in_graph and (
            self._flow.peek_slot.is_used(now) or route.context.ros.takes(route.remote_topic, route.peer.name)
        )

    def told(self) -> None:
        """Look more often while the sending side's verdict is that it rests."""
        if self._route.judged.peer.cause == Cause.RESTING:
            self._awaited.add(self)
        else:
            self._awaited.discard(self)

    def end(self) -> None:
        """Look no more: the opening is over."""
        self._awaited.discard(self)
        self._told = 0, False

    def look(self) -> None:
        """Have the route look who subscribes, if anybody wants the messages of a sender that rests."""
        if self._outputs.subscriber_count or self.wanted:
            self._route.advance()

    def tell(self) -> None:
        """Report soon if it has changed who wants the messages."""
        told = self._flow.audience.count, self.wanted
        if told != self._told:
            self._told = told
            self._route.judge_again()
            self._route.peer.report_soon(self._route)

    def _peeked(self) -> None:
        self._route.wake()  # the next ticks find out that nobody looks any more
        if self._route.judged.peer.cause == Cause.RESTING:
            self.tell()
