"""The publishers of a route that receives: one for each source of messages (`rsb_bridge.route.loop_filter`)."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import KEPT_DEPTH, LATCHED_DEPTH
from rsb_bridge.model.qos import AUTO_DEPTH
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import EndPlace, Endpoint, RosError
from rsb_bridge.route.latched import MESSAGE_COST, LatchedFullError, LatchedTopic
from rsb_bridge.route.peer_budget import TypeUse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rsb_bridge.model.calls import Refused
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Publisher, TopicSpec
    from rsb_bridge.route.message_check import Look, Unpacker
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.records import Source

FREE = 1 << 16  # bytes that each publisher may hold uncounted: small messages pass even if large ones fill the budget
_ASKS_AGAIN_AFTER = 0.01  # s until DDS is asked again while subscribers take nothing (bench/README.md)

# Where nobody has chosen a depth (bench/README.md, *Constants of messages that arrive*):
BURST_DEPTH = 2000  # messages that a publisher keeps at first
_BURST_BYTES = 1 << 20  # kept bytes from which on DDS is asked more often for acknowledgements
_BURST_TIME = 2.0  # s for which there may be more before a publisher that keeps few messages is made
_MATCHED_WITHIN = 2.0  # s in which subscriptions find that one before it takes over: they miss what it publishes before


def bounded(qos: Qos) -> Qos:
    """Return the QoS of publishers here: with what they keep at most for late joiners and slow readers.

    If its liveliness has a lease, it is asserted as the sending side's publishers assert theirs, and by nothing else.
    """
    if qos.liveliness_lease_duration:
        qos = msgspec.structs.replace(qos, liveliness="manual_by_topic")
    if not qos.latched:
        return msgspec.structs.replace(qos, depth=min(qos.depth, KEPT_DEPTH))
    # The sender begins with the same where the depth is unknown.
    depth = LATCHED_DEPTH if qos.history == "keep_all" else min(qos.depth or LATCHED_DEPTH, LATCHED_DEPTH)
    return msgspec.structs.replace(qos, history="keep_last", depth=depth)


class SlowSubscriberError(Exception):
    """DDS would hold too much for subscribers that do not take their messages."""

    def __init__(self, limit: int) -> None:
        super().__init__(
            "a subscriber does not take its messages, and those that wait for it would exceed this topic's share of "
            f"the link's {limit:,} bytes: restart the subscriber, or have it ask for best_effort or a "
            "smaller depth"
        )


class VolatileTopic:
    """A publisher whose memory counts against its link's budget. It belongs to the I/O loop.

    DDS keeps each message until every reliable subscription has acknowledged it, up to the publisher's depth. A program
    that is stopped acknowledges nothing until DDS gives it up, 20 s later. The memory of a message is used again for
    others of the same publisher, and never shrinks; it is freed with the publisher.

    After a process was frozen, its messages come in a burst, faster than subscriptions acknowledge them. A publisher
    that keeps few messages overwrites some that a reliable subscription has missed and requests again. So without a
    chosen depth it keeps many messages, unless a subscription leaves them unacknowledged for long.

    Args:
        publisher: of a volatile topic.
        depth: messages that it keeps at most.
        budget: of the publisher's link; one topic takes no more of it than it leaves to the others.
        now: the clock that all timers use, in s.
        renew: replaces this publisher by one of another depth, or None.
        lasting_depth: messages that it keeps once a subscriber is slow, or None if always `depth`.
    """

    def __init__(
        self,
        publisher: Publisher,
        depth: int,
        budget: Budget,
        now: Callable[[], float],
        renew: Callable[[int], Publisher] | None = None,
        *,
        lasting_depth: int | None = None,
    ) -> None:
        self._publisher = publisher
        self._depth = depth
        self._budget = budget
        self._now = now
        self._renew = renew
        self._lasting_depth = depth if lasting_depth is None else lasting_depth
        self._unacknowledged_since: float | None = None
        self._successor: Publisher | None = None
        self._successor_since = 0.0
        self._moves = False  # whether it takes over in any case
        self._waiting: deque[int] = deque()  # sizes of the memory of messages that may not be acknowledged yet
        self._free: list[int] = []  # of memory that DDS uses next: the block that it freed last comes first
        self._held = self._charged = 0
        self._asks_beyond = FREE  # bytes held from which on DDS is asked
        self._asks_at = float("-inf")

    @property
    def subscriber_count(self) -> int:
        """Subscriptions of other nodes that match now."""
        return self._publisher.subscriber_count

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a subscription for a policy that the graph does not show."""
        return self._publisher.refuses

    def publish(self, content: bytes, look: Look | None = None) -> Refused | None:
        """Publish a message, or return the reason for which it is not wanted any more.

        Args:
            look: asked right before DDS gets the message, or None if it is wanted in any case.

        Raises:
            RosError: the middleware refused it.
            SlowSubscriberError: it would take too much memory.
        """
        size, waiting = len(content) + MESSAGE_COST, self._waiting
        is_full = len(waiting) >= self._depth
        memory = waiting[0] if is_full else self._free[-1] if self._free else 0
        held = self._held if size <= memory else self._held + size - memory
        if held <= self._asks_beyond and (held == self._held or held <= FREE) and self._successor is None:
            # Nothing more is held, or not much: what `_make_room` does, without a call.
            waiting.append(max(size, memory))
            self._held = held
            if is_full:
                waiting.popleft()
            elif self._free:
                self._free.pop()
        else:
            self._make_room(size, memory)
        if look is not None and (why := look()) is not None:
            self.unreserve()
            return why
        self._publisher.publish(content)
        return None

    def reserve(self, content: bytes) -> Publisher:
        """Take memory for a long message as `publish` does, and return the publisher to give it to."""
        self._make_room(len(content) + MESSAGE_COST, self._memory())
        return self._publisher

    def unreserve(self) -> None:
        """Leave the memory of the last message, which DDS did not get, to the next one."""
        if self._waiting:  # else it is closed
            self._free.append(self._waiting.pop())

    def _make_room(self, size: int, memory: int) -> None:
        """Take memory for the next message: ask DDS what is acknowledged, or have another publisher, if needed."""
        growth, deep = size - memory, self._depth > self._lasting_depth
        # Ten large messages would be kept by the other publisher, too.
        full = deep and growth > 0 and self._held + growth > max(_BURST_BYTES, self._lasting_depth * size)
        asks = full or self._held + growth > self._asks_beyond
        if asks:
            self._recycle()
            memory = self._memory()
        since = self._unacknowledged_since
        if self._successor is not None:
            self._look_at_successor()
            memory = self._memory()
        elif full and since is not None and self._renew is not None and self._now() - since >= _BURST_TIME:
            self._successor, self._successor_since = self._renew(self._lasting_depth), self._now()
        try:
            self._reserve(size, memory)
        except SlowSubscriberError:
            if not asks:  # much of that may be acknowledged by now
                self._asks_beyond = 0
                self._make_room(size, memory)
                return
            # DDS may have enough free memory, but in pieces that are too small, or a kept burst fills the budget.
            if self._renew is None or (not deep and (self._waiting or not self._free)):
                raise
            self._begin_anew(self._renew)
            self._reserve(size, 0)

    def move(self) -> bool:
        """Have a publisher that belongs to another node, once subscriptions have found that one.

        Raises:
            RosError: there can be none.
        """
        if self._renew is not None:
            self._drop_successor()
            self._successor, self._successor_since, self._moves = self._renew(self._depth), self._now(), True
        return True

    def settle(self) -> None:
        """Have a publisher of `move` take over, if subscriptions have found it, or had the time to."""
        if self._moves:
            self._look_at_successor()

    def close(self) -> None:
        """Close the publisher, which frees its memory. May be called twice."""
        self._publisher.close()
        self._drop_successor()
        self._forget_memory()

    def _look_at_successor(self) -> None:
        """Replace the publisher once the subscriptions have found the new one, unless they have caught up."""
        assert self._successor is not None
        self._recycle()
        if self._unacknowledged_since is None and not self._moves:
            self._drop_successor()
        elif (
            self._successor.subscriber_count >= self._publisher.subscriber_count
            or self._now() - self._successor_since >= _MATCHED_WITHIN
        ):
            assert self._renew is not None
            self._begin_anew(self._renew)

    def _drop_successor(self) -> None:
        self._moves = False
        if self._successor is not None:
            self._successor.close()
            self._successor = None

    def _begin_anew(self, renew: Callable[[int], Publisher]) -> None:
        """Replace the publisher to free its memory, which is in pieces too small, or kept for a slow subscriber."""
        successor, self._successor = self._successor, None
        # If there can be no other publisher, this raises, and the former one stays.
        former, self._publisher = self._publisher, successor or renew(self._lasting_depth)
        if not self._moves:
            self._depth = self._lasting_depth
        self._moves, self._unacknowledged_since = False, None
        former.close()
        self._forget_memory()

    def _forget_memory(self) -> None:
        self._budget.give(self._charged)
        self._held = self._charged = 0
        self._asks_beyond = FREE
        self._waiting.clear()
        self._free.clear()

    def _memory(self) -> int:
        """Size of the memory that DDS uses for the next message, as far as it is large enough."""
        if len(self._waiting) >= self._depth:
            return self._waiting[0]
        return self._free[-1] if self._free else 0

    def _recycle(self) -> None:
        """Ask DDS whether all messages are acknowledged; if so, their memory is free."""
        now = self._now()
        if now < self._asks_at:
            return
        if self._publisher.acknowledged:
            self._free.extend(self._waiting)
            self._waiting.clear()
            # The more it holds, the less often: of messages of 100 kB one in ten, where each one was asked about.
            self._asks_beyond = self._held + max(FREE, min(self._held, _BURST_BYTES))
            self._unacknowledged_since = None
        else:
            if self._unacknowledged_since is None:
                self._unacknowledged_since = now
            self._asks_at = now + _ASKS_AGAIN_AFTER

    def _reserve(self, size: int, memory: int) -> None:
        growth = max(0, size - memory)
        charge = max(0, self._held + growth - FREE) - self._charged
        if charge > 0:
            # As much as this topic has is left to the link's other topics.
            if self._charged + charge > self._budget.limit - self._budget.held - charge:
                raise SlowSubscriberError(self._budget.limit)
            self._charged += charge
            self._budget.take(charge)
        self._waiting.append(memory + growth)
        if len(self._waiting) > self._depth:
            self._waiting.popleft()
        elif self._free:
            self._free.pop()
        self._held += growth


class _Announced:
    """A DDS publisher that is announced to the domain's other bridges while it is open."""

    def __init__(self, publisher: Publisher, closed: Callable[[bytes], None]) -> None:
        self.gid = publisher.gid
        self.publish = publisher.publish
        self._publisher = publisher
        self._closed = closed

    @property
    def subscriber_count(self) -> int:
        return self._publisher.subscriber_count

    @property
    def refuses(self) -> bool:
        return self._publisher.refuses

    @property
    def acknowledged(self) -> bool:
        return self._publisher.acknowledged

    def assert_liveliness(self) -> None:
        self._publisher.assert_liveliness()

    def close(self) -> None:
        self._closed(self.gid)
        self._publisher.close()


class _SourcePublisher:
    """The publishers of one source."""

    def __init__(self, route: Route, unpacker: Unpacker, spec: TopicSpec, origin: Origin) -> None:
        self._route = route
        self._context = context = route.context
        self._spec = spec
        self._origin = origin
        self._publishers: dict[bytes, Publisher] = {}  # that are open, by their ids
        self.came_by = origin.via[:-1]  # without the sender, which may be another process by now
        self.sink: VolatileTopic | LatchedTopic
        depth, budget = spec.qos.depth, route.peer.budget
        if spec.qos.latched:
            aside = unpacker.publish_latched if route.purpose.in_graph else None
            node = context.ros.mirrors.node_of(EndPlace("publisher", spec.topic, route.peer.name))
            repeats = node != "" and not spec.qos.lifespan  # what is too old would be new once more
            self.sink = LatchedTopic(context.loop, self._advertise, budget.kept, depth, aside, repeats=repeats)
        else:
            keeps_all = spec.qos.history == "keep_all"
            burst = depth == 0 and not keeps_all and spec.qos.reliability == "reliable"
            lasting = depth or AUTO_DEPTH
            first = BURST_DEPTH if burst else lasting
            self.sink = VolatileTopic(
                self._advertise(first),
                KEPT_DEPTH if keeps_all else first,
                budget.unacknowledged,
                context.now,
                self._advertise,
                lasting_depth=lasting if burst else None,
            )

    def set_origin(self, origin: Origin) -> None:
        """Announce another origin of the source's messages.

        Raises:
            RosError: the announcement is full.
        """
        if origin != self._origin:
            self._origin = origin
            for gid in tuple(self._publishers):
                self._announce(gid)

    def set_alive(self, alive: bool) -> None:
        self.set_origin(self._origin._replace(alive=alive))

    def _advertise(self, depth: int) -> Publisher:
        spec = self._spec._replace(qos=msgspec.structs.replace(self._spec.qos, depth=depth))
        publisher = self._route.ends.advertise(spec, self._route.peer.name)
        self._publishers[publisher.gid] = publisher
        try:
            self._announce(publisher.gid)
        except RosError:
            self._closed(publisher.gid)
            publisher.close()
            raise
        return _Announced(publisher, self._closed)

    def assert_liveliness(self) -> int:
        """Assert that the publishers are alive, and return their number."""
        for publisher in self._publishers.values():
            publisher.assert_liveliness()
        return len(self._publishers)

    def _announce(self, gid: bytes) -> None:
        if not self._route.purpose.in_graph:
            return  # no other bridge can take its messages
        endpoint = Endpoint(f"/{self._context.ros.node_name}", *self._spec[1:], gid)
        route = self._route
        self._context.announcements.announce(
            self._spec.topic, route.peer.name, endpoint, self._origin, lambda: route.crossing.flows
        )

    def _closed(self, gid: bytes) -> None:
        self._publishers.pop(gid, None)
        self._context.announcements.withdraw(gid)


class SourcePublishers:
    """The publishers of a route, by the numbers of their sources.

    Attributes:
        sinks: get the messages; in the same order.
    """

    def __init__(self, route: Route, unpacker: Unpacker) -> None:
        self._route = route
        self._unpacker = unpacker
        self._budget = route.peer.budget
        self._type = TypeUse(route.context.ros, self._budget.types)
        self._outputs: list[_SourcePublisher] = []
        self._alive = False
        self.sinks: list[VolatileTopic | LatchedTopic] = []

    def __len__(self) -> int:
        return len(self._outputs)

    def make(self, spec: TopicSpec, sources: Sequence[Source]) -> None:
        """Have a publisher for each source, or for the first ones if there can't be more. Present ones have this spec.

        Args:
            spec: a depth of 0 means that nobody has chosen one, on a volatile topic.

        Raises:
            RosError: there can't be a publisher for the first source, or the link has too many types.
            LatchedFullError: the link's latched topics keep too much for the first source.
        """
        if not self._outputs:
            self._type.begin(spec.type_name, spec.type_hash)
        for number, source in enumerate(sources):
            origin = Origin(source.via, source.live, self._alive)
            try:
                if number < len(self._outputs):
                    self._outputs[number].set_origin(origin)
                else:
                    self._add(spec, origin)
            except (RosError, LatchedFullError):
                self.close(number)  # messages of what cannot be announced could go round
                if number == 0:
                    raise
                return

    def renumber(self, sources: Sequence[Source]) -> None:
        """Take the source numbers of a new opening: publishers stay with their source, or are closed."""
        count = 0
        for source in sources:
            rest = range(count, len(self._outputs))
            at = next((each for each in rest if self._outputs[each].came_by == source.via[:-1]), None)
            # Numbers have no gaps, so publishers after a missing one are made again.
            if at is None:
                break
            self._outputs.insert(count, self._outputs.pop(at))
            self.sinks.insert(count, self.sinks.pop(at))
            count += 1
        self.close(count)

    def _add(self, spec: TopicSpec, origin: Origin) -> None:
        further = len(self._outputs) > 0
        if further and not self._budget.further_publishers.take(1):
            raise RosError("this link has too many publishers")
        try:
            output = _SourcePublisher(self._route, self._unpacker, spec, origin)
        except (RosError, LatchedFullError):
            if further:
                self._budget.further_publishers.give(1)
            raise
        self._outputs.append(output)
        self.sinks.append(output.sink)

    @property
    def subscriber_count(self) -> int:
        return max((sink.subscriber_count for sink in self.sinks), default=0)

    def move(self) -> bool:
        """Have publishers that belong to another node; return whether the sender does not have to repeat anything.

        Raises:
            RosError: there can be none.
            LatchedFullError: the link's latched topics keep too much.
        """
        if self.needs_sender:
            return False
        moved = [sink.move() for sink in self.sinks]
        # Without a message, nothing else looks.
        self._route.context.loop.call_later(_MATCHED_WITHIN, self._settle)
        return all(moved)

    def _settle(self) -> None:
        for sink in self.sinks:
            if isinstance(sink, VolatileTopic):
                sink.settle()

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a subscription for a policy that the graph does not show."""
        return any(sink.refuses for sink in self.sinks)

    def close(self, first: int = 0) -> None:
        """Close the publishers from the number `first` on."""
        while len(self._outputs) > first:
            self.sinks.pop()
            self._outputs.pop().sink.close()
            # The first publisher is in no budget, because each topic has one.
            if self._outputs:
                self._budget.further_publishers.give(1)
        if not first:
            self._type.end()

    def assert_liveliness(self) -> int:
        """Assert that the publishers are alive, and return their number."""
        return sum(output.assert_liveliness() for output in self._outputs)

    def set_alive(self, alive: bool) -> None:
        """Announce whether the publishers are asserted from now on."""
        if alive != self._alive:
            self._alive = alive
            for output in self._outputs:
                with suppress(RosError):  # the announcement is full: bridges learn of it with the next change
                    output.set_alive(alive)

    # --- of latched topics

    def _latched(self) -> list[LatchedTopic]:
        return [sink for sink in self.sinks if isinstance(sink, LatchedTopic)]

    def opened(self) -> dict[bytes, int]:
        """Begin a new opening; return the number of the newest message of each publisher on the sending side."""
        newest: dict[bytes, int] = {}
        for topic in self._latched():
            topic.opened()
            newest |= topic.newest()
        return newest

    @property
    def has_kept(self) -> bool:
        return any(topic.has_kept for topic in self._latched())

    @property
    def needs_sender(self) -> bool:
        """Whether only the sender can repeat what late joiners get: it knows what is too old for that."""
        return self.has_kept if self._route.age.is_on else any(topic.needs_sender for topic in self._latched())

    def present(self, publishers: Mapping[bytes, int]) -> None:
        """Take the publishers that the sending side has now, and their depths as far as it has found them."""
        for topic in self._latched():
            topic.present(publishers)

    def tick(self) -> None:
        for topic in self._latched():
            try:
                topic.tick()
            except (RosError, LatchedFullError) as error:
                self._route.notices.message_error(EventCode.ROUTE_PUBLISH_FAILED, str(error))
