"""The message that a receiving half publishes by itself once an arming ends, or once nothing follows a velocity.

So the robot does not go on moving, even if the last message, which would have stopped it, was lost on the way.

It is agreed when the route opens, so nothing has to cross the link that may just have died. It goes through a publisher
of its own: the publishers of the moving messages are closed first, so nothing that they hold for slow subscribers
follows it.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.cdr.known_types import DRIVING_TYPES, resting, stamped, velocity_of
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.model.by_hand import END_NONE, END_ZERO
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import PEER_DEMANDS
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint, RosError
from rsb_bridge.route.lease import LASTS

if TYPE_CHECKING:
    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Fields
    from rsb_bridge.ros.ros_interface import Publisher, TopicSpec
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.source_publishers import SourcePublishers
    from rsb_bridge.route.topic_flow import TopicFlow

    Mover = Publisher | SourcePublishers
    """What has published a message that moves the robot."""

EVERY = 0.1  # s from one rest to the next. A subscription that asks for best effort may miss one
TIMES = 6  # rests in all, which take 0.5 s: as long as a key held on the drive screen counts
HOLDS = LASTS  # s that a velocity holds without a further message: as old as one may be when it is published
_LATE = 0.001  # s by which it holds longer, so that a message that comes at the last moment counts
_BODY, _STAMPED_BODY = 4, 12  # bytes before a message's fields, and before those behind the stamp of its header


class RestMessage:
    """The rest of one route, which outlives the route until it has been published for the last time.

    Its publisher is there from the opening on, so that subscriptions have found it by the time it is needed.

    `Context.moved_by` says who moved a topic last, so that nobody ends another's motion.

    Args:
        route: has its half `lapse` when a velocity has held for too long, to begin the rest.
        on_end: ``zero``, or a message as JSON.

    Raises:
        RosError: there can be no publisher for it, or its type is not installed.
        FieldError: the message does not fit the type.
    """

    def __init__(self, route: Route, spec: TopicSpec, on_end: str) -> None:
        self.spec, self.on_end = spec, on_end
        self._route, self._context = route, route.context
        context, link = route.context, route.peer.name
        self._fields: Fields | None = None
        self._body_at = _BODY
        # The zero of a type that does not drive is a message of defaults.
        if on_end != END_ZERO or spec.type_name not in DRIVING_TYPES:
            self._read_fields()
        self._holds_until = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._velocity: Velocity | None = None
        self._last: bytes | None = None  # of the messages of the present arming
        self._under_way: asyncio.Task[None] | None = None
        self._is_wanted = True
        published = _resting(spec)
        self._publisher = context.ros.advertise(published, link)
        try:
            endpoint = Endpoint(f"/{context.ros.node_name}", *published[1:], self._publisher.gid)
            context.announcements.announce(spec.topic, link, endpoint, Origin(()))
        except RosError:
            self._publisher.close()
            raise
        self._mover: Mover = self._publisher

    @property
    def velocity(self) -> Velocity | None:
        """The velocity of the newest message or rest, or None if it is unknown or nobody hears it."""
        return None if self._is_moving and not self._mover.subscriber_count else self._velocity

    def moved(self, message: bytes, mover: Mover) -> bool:
        """Note the newest message that this route, or an operator of this side by its arming, has published.

        Returns:
            Whether the robot begins or ceases to move by it.
        """
        was_moving, self._velocity = self._is_moving, velocity_of(self.spec.type_name, message)
        self._last, self._mover = message, mover
        self._context.moved_by[self.spec.topic] = self
        self.stop()
        self._hold()
        return was_moving != self._is_moving

    def fits(self, spec: TopicSpec, on_end: str) -> bool:
        """Whether it can follow messages of a spec: then subscriptions have found its publisher already."""
        return (_resting(spec), on_end) == (_resting(self.spec), self.on_end)

    def replaces(self, before: RestMessage) -> None:
        """Follow the motion that another rest of this route would have ended.

        A hand may drive here while nodes of the other side, with a QoS of theirs, come and go.
        """
        # A rest is made from the last message, so that must have the same type.
        if before.spec.type_name != self.spec.type_name:
            return
        self._last, self._velocity, self._mover = before._last, before._velocity, before._mover
        if self._context.moved_by.get(self.spec.topic) is before:
            self._context.moved_by[self.spec.topic] = self
            self._hold()

    def _hold(self) -> None:
        """Let the last message hold for a moment. Other types than velocities may be meant to hold for good."""
        if self.spec.type_name not in DRIVING_TYPES:
            return
        self._holds_until = self._context.now() + HOLDS + _LATE
        # One timer that looks again when it ends, instead of a new one for each velocity.
        if self._timer is None:
            self._timer = self._context.loop.call_at(self._holds_until, self._end_hold)

    def _end_hold(self) -> None:
        """Begin the rest, unless another message came meanwhile, or somebody else moves the topic."""
        self._timer = None
        if self._last is None or self._context.moved_by.get(self.spec.topic) is not self:
            return
        if self._context.now() < self._holds_until:
            self._timer = self._context.loop.call_at(self._holds_until, self._end_hold)
        else:
            self._route.half.lapse()

    @property
    def _is_moving(self) -> bool:
        return self._velocity is not None and any(self._velocity)

    def stop(self) -> None:
        """Publish no more rests: a message has passed."""
        if self._under_way is not None:
            self._under_way.cancel()
            self._under_way = None

    def begin(self) -> None:
        """Publish it at once and then for some time, if the last message was another one, and this route's."""
        # Once for each motion: a lapse and the disarm after it both come here.
        last, self._last = self._last, None
        if last is None or self._context.moved_by.get(self.spec.topic) is not self:
            return
        rest = last if self._fields is not None else resting(self.spec.type_name, last)
        if rest is None:
            self._failed("the last message that passed is malformed, so no rest follows it")
        elif not self._is_rest(last, rest) and self._publish(rest):
            self._under_way = self._context.loop.create_task(self._go_on(rest))
            self._context.rests.add(self._under_way)
            self._under_way.add_done_callback(self._ended)

    def close(self) -> None:
        """Close its publisher once it has been published for the last time: the route is gone."""
        self._is_wanted = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._under_way is None:
            self._close()

    def _failed(self, text: str) -> None:
        self._route.log(Level.ERROR, EventCode.ROUTE_PUBLISH_FAILED, f"the robot may still move: {text}")

    async def _go_on(self, rest: bytes) -> None:
        for _ in range(TIMES - 1):
            await asyncio.sleep(EVERY)
            # Meanwhile somebody else may drive, and must not be stopped.
            if self._context.moved_by.get(self.spec.topic) is not self or not self._publish(rest):
                return

    def _read_fields(self) -> None:
        fields = read_fields("" if self.on_end == END_ZERO else self.on_end)
        assert isinstance(fields, dict)
        try:
            self._fields = {"header": "auto", **fields}
            self._message()
        except FieldError:  # it may have no header
            self._fields = fields
            self._message()
        else:
            self._body_at = _STAMPED_BODY

    def _message(self) -> bytes:
        """Return the session's message with the present time."""
        assert self._fields is not None
        return self._context.ros.serialize(self.spec.type_name, self._fields, self._context.wall_ns())

    def _is_rest(self, last: bytes, rest: bytes) -> bool:
        """Whether a message is the rest, apart from its stamp."""
        if self._fields is None:
            return last == rest
        return last[self._body_at :] == self._message()[self._body_at :]

    def _publish(self, rest: bytes) -> bool:
        try:
            if self._fields is not None:
                rest = self._message()
            else:
                rest = stamped(self.spec.type_name, rest, self._context.wall_ns())
            self._publisher.publish(rest)
            self._velocity, self._mover = velocity_of(self.spec.type_name, rest), self._publisher
        except (RosError, FieldError) as error:
            self._failed(f"no rest is published: {error}")
            return False
        return True

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._context.rests.discard(task)
        # A message may have ended this rest, and a later one may have begun.
        if self._under_way is task:
            self._under_way = None
        if not self._is_wanted and self._under_way is None:
            self._close()

    def _close(self) -> None:
        if self._context.moved_by.get(self.spec.topic) is self:
            del self._context.moved_by[self.spec.topic]
        self._context.announcements.withdraw(self._publisher.gid)
        self._publisher.close()


class RestAfterArming:
    """Keeps the rest of one route ready, for the type and the QoS that its messages have.

    Attributes:
        message: the rest, or None if none follows.
    """

    def __init__(self, flow: TopicFlow) -> None:
        self.message: RestMessage | None = None
        self._route, self._end = flow.route, flow.end

    def prepare(self, spec: TopicSpec) -> None:
        """Have a rest that can follow messages of a spec.

        Raises:
            RosError: there can be none.
        """
        route, before = self._route, self.message
        on_end = self._end.of(spec.type_name) if route.arming.required else END_NONE
        if before is not None and before.fits(spec, on_end):
            return
        if on_end == END_NONE:
            self.close()
            return
        try:
            rest = RestMessage(route, spec, on_end)
        except (RosError, FieldError) as error:
            lines = ", ".join(map(route.context.demands.origin, route.arming.own.sources))
            raise RosError(f"on_end: {error}; correct it in {lines or PEER_DEMANDS}") from None
        # Before `close`, which forgets the motion.
        if before is not None:
            rest.replaces(before)
        self.close()
        self.message = rest

    def moved_by_hand(self, message: bytes, mover: Mover) -> None:
        """Note a message that an operator of this side has published by the route's arming, after `prepare`."""
        if self.message is not None:
            self.message.moved(message, mover)

    def close(self) -> None:
        """Have no rest any more; one that is being published goes on."""
        if self.message is not None:
            self.message.close()
            self.message = None


def _resting(spec: TopicSpec) -> TopicSpec:
    """Return how a rest is published; subscriptions of either reliability hear it."""
    qos = msgspec.structs.replace(spec.qos, reliability="reliable", depth=1, history="keep_last", durability="volatile")
    return spec._replace(qos=qos)


def velocity_on(context: Context, topic: str) -> Velocity | None:
    """Return the velocity that this bridge has published last on a topic of its domain, as `RestMessage.velocity`."""
    mover = context.moved_by.get(topic)
    return mover.velocity if isinstance(mover, RestMessage) else None
