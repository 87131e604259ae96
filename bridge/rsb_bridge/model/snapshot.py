"""The state and the events of an engine as immutable data, for user interfaces and logs."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import msgspec

from rsb_bridge.model.audience import NOBODY, Audience
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
from rsb_bridge.model.capacity import Capacity, Fullness
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Kind, Topic

# These types must be known where a snapshot is decoded


class State(StrEnum):
    """The state of a route or a link, the worst first."""

    DOWN = "down"
    """No message can cross."""
    STALE = "stale"
    """No message has come for `stale_after`, though one was due."""
    STOPPED = "stopped"
    """No message has come for several of the periods that its rate lets expect."""
    LATE = "late"
    """Messages cross, and take longer than `late_after`."""
    SLOW = "slow"
    """Fewer messages come than its rate lets expect, or part of them is lost."""
    UNHEARD = "unheard"
    """Messages cross, but a publisher or a subscriber that should have a part in it has none, or nobody subscribes."""
    WAITING = "waiting"
    """It waits for the first message; nothing is wrong so far."""
    DISARMING = "disarming"
    """The topic was disarmed, and the other side may act on earlier messages for up to 1 s."""
    PAUSED = "paused"
    DISARMED = "disarmed"
    """It requires arming by an operator before anything crosses."""
    RESTING = "resting"
    """It is lazy, and not subscribed to, as nobody on the other side subscribes."""
    OK = "ok"

    @property
    def is_wanted(self) -> bool:
        """Whether it is as operators want it, though nothing crosses."""
        return self in _WANTED

    @property
    def rank(self) -> int:
        """0 for the worst."""
        return _RANKS[self]

    @property
    def severity(self) -> int:
        """0: nothing is wrong, or nothing is meant to cross yet; 1: a warning; 2: an error."""
        return _SEVERITIES.get(self, 0)

    @property
    def flows(self) -> bool:
        """Whether messages cross, even if too few, too late or unheard."""
        return self in (State.OK, State.UNHEARD, State.SLOW, State.LATE)

    @classmethod
    def _missing_(cls, value: object) -> State | None:
        """Treat an unknown state of a newer version as a warning."""
        return cls.SLOW if isinstance(value, str) else None


_RANKS = {state: rank for rank, state in enumerate(State)}
_WANTED = frozenset({State.DISARMING, State.PAUSED, State.DISARMED, State.RESTING})
_SEVERITIES = {
    State.DOWN: 2, State.STALE: 2, State.STOPPED: 2, State.LATE: 1, State.SLOW: 1, State.UNHEARD: 1,
}  # fmt: skip


class Level(StrEnum):
    """The severity of an event, named as in Python's logging."""

    DEBUG = "DEBUG"
    INFO = "INFO"
    WARNING = "WARNING"
    ERROR = "ERROR"


@dataclass(frozen=True, slots=True)
class Event:
    """An entry of the log for operators."""

    number: int  # counts from 1, without gaps
    time: float  # s since the epoch
    level: Level
    code: str  # its kind, an `rsb_bridge.model.codes.EventCode`; stable, unlike the text
    text: str  # one line, complete in itself
    link: str = ""  # the peer's name, or empty
    topic: str = ""
    who: str = ""  # the operator who caused it, or empty
    old: str = ""  # the value before an operator's change, or empty
    new: str = ""  # the value after an operator's change, or empty
    cause: str = ""
    """A fault has an `rsb_bridge.model.verdict.Cause`, or a newer peer's, a link that is not up an
    `rsb_bridge.model.verdict.LinkCause`, a topic that disarms an `rsb_bridge.route.arming.Disarmed`; else it is empty.
    """
    state: str = ""  # the new `State` of the route or the link, or empty if the event is not about a state
    since: float | None = None  # s since the epoch, when that state began, or None if the event is not about a state
    from_peer: bool = False  # whether the other side reports it

    @property
    def source(self) -> str:
        """Its subject: ``engine``, ``log``, ``key``, ``link`` or ``route``."""
        return self.code.partition(".")[0]


class Stage(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One step on a message's way. The first one that is not `done` is the reason why nothing flows."""

    name: str  # ``publisher seen``, ``type known``, ... (`rsb_bridge.route.route.Route.stages`)
    done: bool | None  # whether the step has passed or failed, or None if it is unknown yet
    detail: str = ""  # the reason in words, or empty


_MEANT = frozenset({"already published", "would loop", "paused", "disarmed"})


@dataclass(frozen=True, slots=True)
class Ledger:
    """The balance of a route's messages.

    ``offered = delivered + throttled + dropped + expired + unknown + waiting + in_flight``. All are message counts
    since the route was made. `dropped` says each cause: ``queue full``, ``keep full``, ``outage``, ``link lost``,
    ``lost on the way``, ``too large``, ``publish failed``, ``latched full``, ``slow subscriber``, ``expands too much``,
    ``malformed``, ``too complex``, ``would loop``, ``paused``, ``disarmed``, ``incomplete``, ``replaced``.
    """

    offered: int = 0  # taken from ROS on the sending side
    delivered: int = 0  # given to DDS on the receiving side
    throttled: int = 0  # left out for a highest rate
    expired: int = 0  # dropped because they were older than `max_age`, their publisher's lifespan or a command may be
    in_flight: int = 0  # sent, and not reported yet by the receiving side
    dropped: dict[str, int] = field(default_factory=dict)
    unknown: int = 0  # sent to a process that ended before it reported whether they arrived
    lost_in_dds: int = 0  # lost before the subscribed bridge could take them; not part of `offered`
    missed_while_down: int = 0
    """Published while the route was closed: its link was down for longer than it outlives. Not part of `offered`."""
    unsubscribed: int = 0
    """Published before the bridge subscribed first, or while the topic was not to cross (paused, disarmed, refused).
    Not part of `offered`."""
    again: int = 0
    """Of `offered`, a latched topic's messages that were offered before, such as to the peer before its restart."""
    waiting: int = 0  # not sent yet
    waiting_since: float | None = None
    """s since the epoch, when the oldest message in the queue came, or None if the queue is empty."""

    @property
    def open(self) -> int:
        """Messages whose end is not known yet."""
        return self.waiting + self.in_flight

    @property
    def dropped_total(self) -> int:
        return sum(self.dropped.values())

    @property
    def lost(self) -> int:
        """Messages that were too old or dropped, without the drops that an operator or the bridge wants."""
        return self.expired + sum(count for cause, count in self.dropped.items() if cause not in _MEANT)


@dataclass(frozen=True, slots=True)
class ArmingSnapshot:
    """Whether a topic that requires arming is armed."""

    armed: bool  # on this side
    by: str = ""  # the operator who armed it, or empty. An operator of the other side has that side's name before
    here: bool = False  # whether it was armed on this side
    left: float | None = None
    """s until it disarms unless that operator presses a key, or None if it is not armed or has no deadman."""
    deadman: float = 0.0  # s, or 0 for none
    demanded_by: tuple[str, ...] = ()  # the lines that demand arming: ``robot.yaml:14``
    why: str = ""
    """The cause why it is not armed, as of `EventCode.ROUTE_DISARMED`, or "operator" or "not_yet"; empty while it is
    armed."""
    reason: str = ""  # the same in words, with the operator who disarmed it
    on_end: str = ""
    """The robot gets this when the arming ends: ``zero``, ``none``, or a message as JSON. It is empty for what is no
    topic, and while the type is unknown."""
    velocity: tuple[float, float] | None = None
    """The velocity that the robot's side has given the robot last: forward in m/s, and turn in rad/s; both are 0 after
    the end of an arming. None if nobody hears it, or it is unknown, as of types that are not Twist or TwistStamped."""
    asked_by: str = ""  # the operator who asks the holder for it, or empty
    goes_in: float | None = None  # s until it goes over to that operator without an answer, or None if nobody asks

    @property
    def is_demanded_twice(self) -> bool:
        """Whether several lines demand it, so that an operator who ends one of them does not end the demand."""
        return len(self.demanded_by) > 1


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """An operator has acknowledged a fault: it does not count until its state or its cause changes."""

    by: str  # the operator, in words
    at: float  # s since the epoch


@dataclass(frozen=True, slots=True)
class Driver:
    """A node, a link or an operator's hand that publishes what moves a robot."""

    name: str  # of the node, ``link NAME`` for another link of that side's bridge, or empty for a hand
    here: bool  # whether it publishes on this side
    rate: float | None = None  # Hz that this route takes of it, or None: it publishes beside the link, uncounted
    by_hand: bool = False


@dataclass(frozen=True, slots=True)
class RouteSnapshot:
    """One topic in one direction over one link, or one service, action or node's parameters (`spec.kind`)."""

    key: str  # names the route in commands; stable across reconnects
    link: str
    topic: str  # its name on this side
    remote_topic: str  # its name on the other side
    outgoing: bool  # whether this side sends; of a service, action or parameters, whether the callers are here
    spec: Topic  # the topic as it was asked for, as the client sees it
    state: State  # the worse of both sides' states; `reason` explains it and names the other side if that reports it
    reason: str
    type_name: str  # or empty if it is unknown yet
    type_hash: str  # or empty if it is unknown yet
    qos: Qos | None  # of the bridge's endpoints on both sides, or None if it is unknown yet
    publisher_qos: Qos | None  # combined offer of its publishers, without depths, or None without publishers
    subscriber_qos: Qos | None  # combined request of its subscriptions, without depths, or None without subscriptions
    transport: str  # ``tcp``, ``udp`` or ``bluetooth``
    port: int  # the port or channel that carries it
    stages: tuple[Stage, ...]
    ledger: Ledger
    rate: float  # Hz, over the last seconds
    expected_rate: float | None  # Hz, given or learned, or None if it is unknown yet
    bytes_per_second: float
    bytes_total: int
    latency_p50: float | None  # s, one way, or None without a figure
    latency_p99: float | None
    latency_uncertainty: float | None  # s, the uncertainty of the clock offset that they contain
    jitter: float | None  # s (RFC 3550 section 6.4.1), or None without a figure
    last_at: float | None
    """s since the epoch, when the last message came, or None before the first. No age, which would be of the moment at
    which the route was looked at."""
    history: tuple[int, ...]  # messages in each of the last seconds, up to 120, oldest first
    last_error: str
    cause: str = ""  # of the state, an `rsb_bridge.model.verdict.Cause`, one of a newer peer, or empty
    from_peer: bool = False  # whether the other side reports the state
    since: float = 0.0  # s since the epoch, the beginning of this state and cause, as far as this process knows
    publishers: tuple[str, ...] = ()  # known nodes that publish it on the sending side
    subscribers: tuple[str, ...] = ()
    """Known nodes that subscribe to it on the receiving side, whether they hear it or not."""
    drivers: tuple[Driver, ...] = ()
    """If it moves a robot: the publishers on the sending side, and on the receiving side those beside this link."""
    audience: Audience = NOBODY  # the subscriptions on the receiving side; empty of what is no topic
    arming: ArmingSnapshot | None = None  # whether it is armed, or None if arming is not required
    max_rate: float | None = None
    """The lowest limit (Hz) of the topic's entry, both sides' rights and the sending side's profile, or None."""
    calls: CallsSnapshot | None = None  # its calls, which `rate`, `history` and `age` then count, or None for a topic
    goals: tuple[GoalSnapshot, ...] = ()  # the newest goals of an action, unfinished ones first
    lanes: tuple[str, ...] = ()
    """Names that can be called by hand, such as ``set_parameters``; a service has one, ``""``; a topic none."""
    pattern: str = ""  # of this side's session that made it, or empty
    messages_total: int = 0
    """Messages or calls that `rate` and `bytes_total` count: on the sending side those given to the link, on the
    receiving side those published."""
    last_error_at: float = 0.0  # s since the epoch, its time, or 0 without one
    acknowledged: Acknowledgement | None = None
    """The acknowledgement of its fault, or None. A link's covers the routes that are down with it."""
    max_age: float = 0.0
    """s after which a message or a request is dropped, as the two sides' sessions say, or 0 for no limit."""
    limits: VelocityLimits | None = None
    """The most that a hand may ask, as the two sides' sessions say, or None for any velocity."""
    limited_by: tuple[str, ...] = ()  # the lines that have a number of `limits`: ``robot.yaml:14``
    purpose: str = "topic"  # what it carries, as in `rsb_bridge.model.purposes`
    features: dict[str, Any] = field(default_factory=dict)
    """The values that features show of it, by name (`rsb_bridge.feature.ShownField.of`)."""

    def age(self, now: float) -> float | None:
        """Return s since the last message at `now`, the `Snapshot.time`, or None before the first."""
        return None if self.last_at is None else max(0.0, now - self.last_at)


@dataclass(frozen=True, slots=True)
class PatternSnapshot:
    """A pattern of a session, which makes a route of each name that matches."""

    key: str  # identifies it in commands, as `RouteSnapshot.key` does a route
    link: str
    spec: Topic  # its entry in the session
    state: State  # WAITING while nothing matches, DOWN if something that matches is not bridged, else OK
    reason: str  # how many names are bridged, and why others are not
    here: bool  # whether it follows this side's graph, not the other side's
    source: str  # the pattern for the names of that graph
    routes: int = 0  # number of routes that it has made
    gone: int = 0  # number of these routes without a publisher now
    beyond: int = 0  # number of matching names beyond the limit, which are not bridged
    acknowledged: Acknowledgement | None = None

    @property
    def cause(self) -> str:
        """The cause of its fault: patterns have none yet."""
        return ""


@dataclass(frozen=True, slots=True)
class WaySnapshot:
    """One of several ways to the peer: to an address that a client's session lists, or of one connection over all."""

    host: str  # as the session lists it; of one connection this end, and on a server the client's
    device: str  # of this machine, that leads there, or empty if it is unknown
    is_used: bool
    is_ready: bool  # whether it answered when it was last tried; one in use is not, unless it is of one connection


@dataclass(frozen=True, slots=True)
class LinkSnapshot:
    """One peer."""

    name: str  # the client's name (on a client: its own, which is the link's)
    peer: str  # address of the other side, ``host:port`` or ``MAC channel n``; while it is down, where it was last seen
    state: State  # OK if linked, WAITING before the first attempt, else DOWN; `reason` says why
    reason: str
    since: float  # s since the epoch, when this state began
    retry_in: float | None  # s until the next attempt, 0 during an attempt, or None if none is planned
    attempts: int  # failed attempts since it was last linked
    encrypted: bool  # False must be shown in red
    cipher: str  # ``AESGCM``, ``ChaChaPoly``, or empty
    fingerprint: str  # of the key in use, or of this side's key while the link is down
    rtt: float | None  # s, or None without a figure
    clock_offset: float | None  # s, peer's clock minus ours, or None without a figure
    clock_uncertainty: float | None
    rx_bytes_per_second: float  # wire bytes received
    tx_bytes_per_second: float  # wire bytes sent
    peer_version: str  # the other side's rsb-console version, or empty
    peer_domain: int | None  # the other side's ROS domain, or None before the first connection
    use_name: bool = False  # whether the client's name prefixes its topics on the server
    cause: str = ""  # of a fault, an `rsb_bridge.model.verdict.LinkCause`, or empty
    warning: str = ""  # a fault that does not take the link down, for an operator, or empty
    next_fingerprint: str = ""  # on a server, of the client's next key, which is valid already, or empty
    capacity_out: Capacity | None = None  # measured capacity from here, or None if it is unknown
    capacity_in: Capacity | None = None  # measured capacity to here, or None if it is unknown
    rx_bytes_total: int = 0  # wire bytes received in this process, over all connections
    tx_bytes_total: int = 0  # wire bytes sent in this process, over all connections
    patterns: tuple[PatternSnapshot, ...] = ()  # of this side's session, in its order
    full_out: Fullness | None = None  # the rates from here, or None if the link is not full
    full_in: Fullness | None = None  # the rates to here, as the peer reports them, or None if the link is not full
    loss_out: float | None = None  # share of the packets from here that is lost, 0 to 1, or None without a figure
    loss_in: float | None = None  # the same to here, as the peer reports it
    association_ends: float | None = None
    """S since the epoch, when what waits for it is dropped unless it is back; None while it is up, or nothing waits."""
    via: str = ""  # this machine's network device that carries it, or empty if it is unknown
    ways: tuple[WaySnapshot, ...] = ()  # if there are several; of a client's addresses the preferred one first
    unsaved_there: bool = False  # whether the other side's file lacks a change that was made here
    warning_since: float | None = None
    """s since the epoch, when `warning` or its cause began, or None without a warning."""
    acknowledged: Acknowledgement | None = None
    features: dict[str, Any] = field(default_factory=dict)
    """The values that features show of it, by name (`rsb_bridge.feature.ShownField.of`)."""

    @property
    def fault_since(self) -> float:
        """S since the epoch, when its fault began; without one, when its state began."""
        return self.since if self.warning_since is None else self.warning_since


@dataclass(frozen=True, slots=True)
class RefusedClient:
    """A refused client that no link of its server shows."""

    name: str  # that the client gave, or empty
    host: str
    cause: str  # the reason as an `rsb_bridge.model.verdict.LinkCause`
    reason: str  # the same in words, with the remedy
    since: float  # s since the epoch, when it was first refused
    attempts: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole engine at one moment."""

    time: float  # s since the epoch
    name: str
    role: str
    address: str  # the address that is bound, or that of the server that was called last
    domain_id: int
    running: bool  # False: stopped, or not started
    links: tuple[LinkSnapshot, ...] = ()  # on a server, one for each known client
    routes: tuple[RouteSnapshot, ...] = ()
    last_event: int = 0  # number of the newest event
    refused: tuple[RefusedClient, ...] = ()
    unsaved: bool = False  # whether the running session differs from its file; False without a file


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of one side's graph, or a service, an action or a node with parameters."""

    topic: str
    type_name: str  # its type, or empty if its endpoints disagree
    type_hash: str  # of its type, or empty
    qos: Qos | None  # combined offer of its publishers, or None without publishers and for other kinds
    publishers: int  # number of publishers, or of providers
    subscriptions: int  # number of subscriptions, or of callers
    kind: Kind = "topic"


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Differences between the session file and the running session, in words."""

    changed: tuple[str, ...] = ()  # changes that the bridge has made, or would make if it was only asked
    left: tuple[str, ...] = ()  # changes that need a restart, with the remedy
    failed: tuple[str, ...] = ()  # changes that failed, with the reason
    digest: str = ""  # identifies `changed`, which may be cut on the way to a console; empty if `changed` is


PEEK_LIMIT = 1 << 20  # bytes of a message that are shown: a whole map, and the beginning of a large picture


@dataclass(frozen=True, slots=True)
class PeekedMessage:
    """A message of a route, as it passed this side."""

    payload: bytes
    """The serialized message with its encapsulation header; of a longer one, the first `PEEK_LIMIT` bytes."""
    size: int  # bytes of the whole message
    type_name: str
    type_hash: str  # ``RIHS01_...``, or empty
    time: float
    """s since the epoch on this machine's clock, when DDS received it (sending side), or when it came over the link
    (receiving side)."""
    outgoing: bool  # whether this side sends it
    is_kept: bool = False
    """Whether it is a latched topic's earlier message, as a late joiner gets it; `time` is then that of the request."""
    latency: float | None = None
    """s that it took over the link, by the clock offset, or None if it is unknown or this side sends it."""
    clock_offset: float | None = None
    """s, the peer's clock minus this machine's, 0 if the bridge has shifted the stamps by it, or None if unknown."""
    clock_uncertainty: float | None = None
