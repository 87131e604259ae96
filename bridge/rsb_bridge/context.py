"""The state that all parts of a running engine share."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

from rsb_bridge.config.session_file import SessionInFile
from rsb_bridge.model.clock import Clock, StampClock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import operator
from rsb_bridge.model.demands import RunningDemands
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.announcements import Announcements
from rsb_bridge.ros.internal_ends import InternalEnds
from rsb_bridge.ros.parameter_events import ParameterEvents
from rsb_bridge.ros.ros_graph import NameSuggester, SimilarTopics
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.ros.type_descriptions import TypeCheckers, TypeDescriptions
from rsb_bridge.telemetry.event_log import RateLimitedEventLog
from rsb_bridge.transport.registry import Transports, default_transports

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence
    from enum import StrEnum

    from rsb_bridge.model.demands import DemandSource
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.session import ArmedName, Session
    from rsb_bridge.ros.ros_interface import RosInterface, RouteEnds
    from rsb_bridge.ros.ros_thread import RosToLoopQueue
    from rsb_bridge.telemetry.event_log import About, EventLog


T = TypeVar("T")


@dataclass(slots=True)
class Context:
    """The parts that routes and links work with.

    Attributes:
        session: for its defaults; the engine looks after its topics and clients.
        ros_queue: from the ROS thread to the I/O loop.
        loop: the I/O loop; all engine state belongs to its thread.
        random: for jitter; never for secrets.
        in_file: what the session file holds.
        internal: the ends of internal routes, by purpose.
        limited: adds events that a peer may cause to `events`, up to a rate.
        now: seconds on the monotonic clock of all timers.
        stamps: the clock by which the age of messages is measured.
        announcements: messages between this bridge and the others in its domain.
        descriptions: of the message types that operators look at.
        checkers: of the types of peers' messages.
        parameter_events: of the nodes whose parameters are bridged.
        similar_topics: suggests topics for a misspelt name.
        suggester: suggests services, actions and nodes for a misspelt name.
        demands: the names that have to be armed, as the running session demands it.
        moved_by: the rest messages of the routes that have moved a topic last, by the topic's name.
        rests: tasks that publish rests after an arming, to be awaited before the ROS side stops.
        names_changed: to be called when another set of names of the graph is followed (`link.graph_watch.NameWatch`).
        is_unsaved: returns whether the running session differs from its file; with many topics it takes a while.
        is_looked_at: returns whether anybody looks at the figures all the time, as an attached console does.
        place: places a route's ends in ROS (`route.half.Half.places`), which may be made now, by the names of nodes on
            the other side that have it.
        tap_of: returns what gets all messages of a topic (`route.peeking.Tap`), or None. It takes the topic's name on
            this side, and a route or another object with `type_name`, `type_hash` and `qos`.
    """

    session: Session
    domain_id: int
    ros: RosInterface
    events: EventLog
    ros_queue: RosToLoopQueue
    loop: asyncio.AbstractEventLoop
    clock: Clock = field(default_factory=Clock)
    random: Random = field(default_factory=Random)
    transports: Transports = field(default_factory=default_transports)
    in_file: SessionInFile = field(default_factory=SessionInFile)
    internal: dict[str, InternalEnds[Any, Any]] = field(init=False)
    limited: RateLimitedEventLog = field(init=False)
    now: Callable[[], float] = field(init=False)
    stamps: StampClock = field(init=False)
    announcements: Announcements = field(init=False)
    descriptions: TypeDescriptions = field(init=False)
    checkers: TypeCheckers = field(init=False)
    parameter_events: ParameterEvents = field(init=False)
    similar_topics: SimilarTopics = field(init=False)
    suggester: NameSuggester = field(init=False)
    demands: RunningDemands = field(init=False)
    moved_by: dict[str, object] = field(default_factory=dict)
    rests: set[asyncio.Task[None]] = field(default_factory=set)
    names_changed: Callable[[], None] = lambda: None
    is_unsaved: Callable[[], bool] = lambda: False
    is_looked_at: Callable[[], bool] = lambda: False
    place: Callable[[Any, Sequence[str]], None] = lambda _, __: None
    tap_of: Callable[[str, Any], Callable[[bytes, int, int, bytes, int], None] | None] = lambda _, __: None
    _shared: dict[Callable[[Context], Any], Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.internal = {each.name: InternalEnds(each) for each in purposes().values() if not each.in_graph}
        self.now = self.loop.time
        self.stamps = StampClock(self.clock)
        self.limited = RateLimitedEventLog(self.events, self.now)
        self.announcements = Announcements(self.ros, self.loop, self._warn)
        self.descriptions = TypeDescriptions(self.ros, self.now)
        self.checkers = TypeCheckers(self.ros, self.descriptions)
        self.parameter_events = ParameterEvents(self.ros, self.call)
        self.similar_topics = SimilarTopics(self.ros, self.loop)
        self.suggester = NameSuggester(self.ros, self.loop)
        self.demands = RunningDemands(self)

    @property
    def armed_in_file(self) -> tuple[str | ArmedName, ...]:
        """`armed` of the session's file."""
        return () if self.in_file.session is None else self.in_file.session.armed

    def demands_changed(self) -> None:
        """Have the routes reopened soon whose demands have changed."""
        self.loop.call_soon(self.demands.apply)

    def demand_dropped(self, source: DemandSource, origin: str) -> None:
        """Log that an operator has dropped a demand."""
        who = operator()
        text = f"{source.name}: no longer has to be armed: {who} dropped the demand ({origin})"
        about: About = {"topic": source.name, "who": who, "old": origin}
        self.events.add(Level.WARNING, EventCode.OPERATOR_ARM_DROPPED, text, **about)

    def log(self, level: Level, code: StrEnum, text: str, *, link_status: bool = False, **about: Unpack[About]) -> None:
        """Add an event. A link's event is dropped if the link has used up its share (`RateLimitedEventLog`)."""
        if about.get("link"):
            self.limited.add(level, code, text, link_status=link_status, **about)
        else:
            self.events.add(level, code, text, **about)

    def _warn(self, text: str) -> None:
        self.log(Level.WARNING, EventCode.ENGINE_ANNOUNCEMENTS, text)

    def ends(self, purpose: Purpose) -> RouteEnds:
        """Return where the routes of a purpose have their endpoints."""
        return self.ros if purpose.in_graph else self.internal[purpose.name]

    def shared(self, make: Callable[[Context], T]) -> T:
        """Return what `make` makes once in an engine: what a feature's links and its part of the engine share."""
        if make not in self._shared:
            self._shared[make] = make(self)
        shared: T = self._shared[make]
        return shared

    def call(self, work: Callable[[], None]) -> None:
        """Do something on the I/O thread, from another; nothing happens once the engine has stopped."""
        with contextlib.suppress(RuntimeError):
            self.loop.call_soon_threadsafe(work)

    def load_type(self, type_name: str) -> asyncio.Future[None]:
        """Import a message type on another thread, if it is installed here.

        The first import of a package takes up to a second on a busy machine. In the loop, that would end the lease of
        everything that is armed.
        """
        return self.loop.run_in_executor(None, self._load_type, type_name)

    def _load_type(self, type_name: str) -> None:
        with contextlib.suppress(RosError):  # its user reports that
            self.ros.installed_hash(type_name)

    @property
    def domain(self) -> str:
        """The domain where nodes are missed, as texts name it: with how their discovery is, if that may be why."""
        found = self.ros.discovery.found
        return f"{self.domain_id} ({found})" if found else str(self.domain_id)

    def wall(self) -> float:
        """Return the seconds since the epoch on the wall clock, which may be set at any time."""
        return self.clock.time_ns() / 1e9

    def wall_of(self, steady: float) -> float:
        """Return when something was (s since the epoch) by its time on the steady clock.

        So the date of a robot that has none until it is linked becomes right with its clock. A tenth of a second is as
        exact as two clocks can be read, and does not differ each time that somebody asks.
        """
        return round(self.wall() - (self.clock.steady() - steady), 1)

    def wall_ns(self) -> int:
        """Nanoseconds since the epoch on the wall clock."""
        return self.clock.time_ns()
