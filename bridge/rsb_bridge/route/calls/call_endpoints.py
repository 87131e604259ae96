"""The endpoints of a route of calls in ROS: clients and subscriptions, or services and publishers."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError, TopicSpec
from rsb_bridge.route.calls.calls_end import Trouble
from rsb_bridge.route.peer_budget import TypeUse

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import LaneEntry

_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s between attempts, at first and at most. Round figures: nothing announces that ROS would take an endpoint now."""
_HEALED_AFTER = 60.0
"""s without a failure after which the first delay applies again: twice the longest delay."""


class LanesOwner(Protocol):
    """An owner of open lanes, which takes what comes from ROS."""

    def failed(self, error: RosError) -> None:
        """Close all lanes, as ROS refuses one, or one has failed and closed itself."""


class OpenLane:
    """A lane's endpoint in ROS on this side, from when it is opened until it is closed.

    Attributes:
        lane: its place among the route's members.
        version: the type of its service or topic.
    """

    _owner: Any

    def __init__(self, flow: CallsFlow, owner: LanesOwner, lane: int, version: TypeVersion) -> None:
        """Open it.

        Raises:
            RosError: ROS refuses it, or the link's topics have too many types.
        """
        self._route = route = flow.route
        self.lane = lane
        self.version = version
        self._owner = owner
        self._member = flow.members[lane]
        self._name = self._member.name_on(route.local_topic)
        self._is_open = True
        # A partial, as each function between here and the queue would be called with each batch.
        self._put: Callable[[Sequence[Any]], None] = partial(route.context.ros_queue.put, self, express=True)
        with ExitStack() as held:
            use = TypeUse(route.context.ros, route.peer.budget.types)
            use.begin(version.name, version.type_hash, is_service=not self._member.is_topic)
            held.callback(use.end)
            self._open(held)
            self._held = held.pop_all()

    def _open(self, held: ExitStack) -> None:
        """Make the endpoint, and have `held` close it and all that goes with it."""
        raise NotImplementedError

    def offer(self, batch: Sequence[Any]) -> None:
        """Take a batch from ROS; called on the I/O loop, maybe after it was closed."""

    def _spec(self) -> TopicSpec:
        assert self._member.qos is not None
        return TopicSpec(self._name, *self.version, self._member.qos)

    def _failed(self, error: RosError) -> None:
        """Have the owner handle that the endpoint has closed itself; called on the ROS thread."""
        self._route.context.call(lambda: self._handle_failure(error))

    def _handle_failure(self, error: RosError) -> None:
        if self._is_open:  # else another endpoint is in its place
            self._owner.failed(error)
            self._route.advance()  # the other side may have to hear of it

    def close(self) -> None:
        """Close the endpoint."""
        self._is_open = False
        self._held.close()


class RosRetry:
    """Delays new attempts of a route after ROS has refused an endpoint.

    Attributes:
        trouble: the last failure, or None once an attempt has succeeded.
    """

    def __init__(self, route: Route) -> None:
        self.trouble: Trouble | None = None
        self._route = route
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._failed_at = float("-inf")
        self._entries: Sequence[LaneEntry] = ()
        self._timer: asyncio.TimerHandle | None = None

    def waits(self, entries: Sequence[LaneEntry]) -> bool:
        """Return whether endpoints of these types failed so lately that it is too early for a new attempt."""
        return self._timer is not None and entries == self._entries

    def failed(self, text: str, entries: Sequence[LaneEntry]) -> None:
        """Report that endpoints of these types could not be made, or closed themselves, for a reason in words.

        They are tried again later, others at once.
        """
        now = self._route.context.now()
        if now - self._failed_at >= _HEALED_AFTER:
            self._backoff.reset()
        self._failed_at, self._entries = now, entries
        self.trouble = Trouble(Cause.OFFER_FAILED, f"{text}; trying again")
        self._stop()
        self._timer = self._route.context.loop.call_later(self._backoff.next(), self._due)
        self._route.notices.error(EventCode.ROUTE_OFFER_FAILED, text)
        self._route.judge_again()

    def clear(self) -> None:
        """Note that all endpoints that are wanted exist."""
        self.trouble = None
        self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        if self._route.id:
            self._route.advance()


S = TypeVar("S", bound=OpenLane)
T = TypeVar("T", bound=OpenLane)


class OpenLanes(Generic[S, T]):
    """The open lanes of one half. Its services open and close together; a topic opens once its type has been found.

    Args:
        owner: of each lane.
        service, topic: the classes of its lanes.

    Attributes:
        services, topics: by lane.
        retry: delays new attempts after ROS has refused an endpoint.
    """

    def __init__(self, flow: CallsFlow, owner: LanesOwner, service: type[S], topic: type[T]) -> None:
        self.services: dict[int, S] = {}
        self.topics: dict[int, T] = {}
        self.retry = RosRetry(flow.route)
        self._entries: Sequence[LaneEntry] = ()  # the types that were wanted last
        self._flow = flow
        self._owner = owner
        self._service = service
        self._topic = topic

    def fitting(self, entries: Sequence[LaneEntry]) -> set[int]:
        """Return the lanes of open services that have these types."""
        return {lane for lane, each in self.services.items() if each.version == version_of(entries[lane])}

    def open(self, entries: Sequence[LaneEntry], lanes: Collection[int]) -> None:
        """Have the services of these lanes open, and no others.

        Raises:
            RosError: one cannot be opened; nothing is left open.
        """
        self._entries = entries
        fitting = self.fitting(entries)
        # The types of most topics follow from the route's.
        topics = self.topics if len(fitting) == len(self.services) else ()
        self.close(keep={*fitting.intersection(lanes), *topics})
        with ExitStack() as failed:
            failed.callback(self.close)
            for lane, (member, entry) in enumerate(zip(self._flow.members, entries, strict=True)):
                if lane in lanes and not member.is_topic and lane not in self.services:
                    self.services[lane] = self._service(self._flow, self._owner, lane, version_of(entry))
            failed.pop_all()

    def open_topics(self, entries: Sequence[LaneEntry]) -> list[T]:
        """Open the topics whose types are known by now, and return them.

        Raises:
            RosError: one cannot be opened.
        """
        self._entries, new = entries, []
        for lane, (member, entry) in enumerate(zip(self._flow.members, entries, strict=True)):
            if member.is_topic and entry.type_hash and lane not in self.topics:
                self.topics[lane] = topic = self._topic(self._flow, self._owner, lane, version_of(entry))
                new.append(topic)
        return new

    def failed(self, text: str) -> None:
        """Close all lanes for a reason in words, and have the same types tried again later."""
        self.close()
        self.retry.failed(text, self._entries)

    def close(self, keep: Collection[int] = ()) -> None:
        """Close all lanes except those to keep."""
        ends: tuple[dict[int, S] | dict[int, T], ...] = self.services, self.topics
        for open_lanes in ends:
            for lane in [each for each in open_lanes if each not in keep]:
                open_lanes.pop(lane).close()


def version_of(entry: LaneEntry) -> TypeVersion:
    """Return the type of a lane."""
    return TypeVersion(entry.type, entry.type_hash)
