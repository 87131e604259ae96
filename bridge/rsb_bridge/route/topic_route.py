"""One topic in one direction over one link: the base of both halves, with watches of silence, rest and traffic."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Generic, TypeVar

from rsb_bridge.cdr.known_types import DRIVING_TYPES
from rsb_bridge.model.audience import NOBODY
from rsb_bridge.model.by_hand import END_ZERO, agreed_end
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import EXPIRES, Cause, LinkCause
from rsb_bridge.route.idling import POLLED_EVERY
from rsb_bridge.route.lateness import Late, LateWatch
from rsb_bridge.route.peeking import PeekSlot
from rsb_bridge.route.route import Route
from rsb_bridge.route.topic_verdict import LOSS_CAUSES
from rsb_bridge.telemetry.meters import LatencyMeter, Smoothed, StaleWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.channel.channel import DataChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.model.snapshot import Ledger, RouteSnapshot
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.peeking import Tap
    from rsb_bridge.route.route import Owner
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.records import ReceivedReport, SentReport

ChannelT = TypeVar("ChannelT", bound="DataChannel")
_EXPLAINS = frozenset(
    {
        Cause.NO_PATH,
        Cause.AWAITS_LINK,
        Cause.SUBSCRIBE_FAILED,
        Cause.QOS_INCOMPATIBLE,
        Cause.TYPE_CONFLICT,
        Cause.TYPE_UNKNOWN,
        Cause.NO_PUBLISHER,
        Cause.SIMILAR_NAME,
        Cause.PUBLISHER_GONE,
        Cause.TOO_LARGE,
        Cause.NOT_PUBLISHED,
        Cause.LOSSY,
    }
)
"""Causes of silence. Others are silence itself, in other words, or go with messages."""
_LATENCY_TICKS = 10  # seconds of messages that the shown latency is of: so many samples would take minutes at low rates
MEASURED_FOR = 6.0  # s of lateness or loss after which a full link has been noticed
_DRAINS_FOR = 60.0  # s for which messages may be late or lost because their link was full: a round figure
_SILENT = State.STALE, State.STOPPED
_UNUSUAL = frozenset({Cause.LATE, *LOSS_CAUSES, *EXPIRES})

# Of what a topic wants to send.
_PER_MESSAGE = 60  # bytes on the wire besides a message's content: header, seal, and a part of the packets' headers
_SIZE_FADES = 0.8  # part of the earlier messages that counts a second later for the average size: of about five


class SilenceWatch:
    """Warns of a route's silence after the time that its topic's entry or the session says.

    Attributes:
        own: the topic's entry says after how long it is stale.
        watch: the time of the last message, and the warnings since.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None], now: float) -> None:
        self.own = False
        self._log = log
        self.watch = StaleWatch(0.0, 0, now)
        self._warned = False  # in the log, since a message came

    def configure(self, topic: Topic, session: Session) -> None:
        """Watch as the topic's entry and the session say now."""
        self.own = topic.stale_after is not None
        self.watch.after = session.stale_after if topic.stale_after is None else topic.stale_after
        self.watch.times = session.stale_warnings

    def rearm(self, now: float) -> None:
        """Begin again: no message was due before `now` (s)."""
        self.watch.rearm(now)
        self._warned = False

    def tick(self, now: float, cause: str) -> None:
        """Warn if nothing has come for too long. Called once a second while messages that are due do not come.

        Args:
            cause: of the route's state. A cause that explains the silence is logged already, and not repeated.
        """
        if (number := self.watch.check(now)) and cause not in _EXPLAINS:
            self._warned = True
            text = f"nothing for {self.watch.after * number:g} s (warning {number} of {self.watch.times})"
            if number == self.watch.times:
                text += "; no further warnings until data returns"
            self._log(Level.WARNING, EventCode.ROUTE_STALE, text)

    def seen(self, now: float) -> None:
        """Note a message that came at `now` (s)."""
        # Nearly always, so that each message saves a call.
        if not self.watch.warned:
            self.watch.quiet_since = now
            return
        quiet = self.watch.seen(now)
        if quiet is not None and self._warned:
            self._log(Level.INFO, EventCode.ROUTE_DATA_AGAIN, f"reinitialized: data again after {quiet:.0f} s")
        self._warned = False

    @property
    def due(self) -> float:
        """Time (s) at which it is too long ago, or infinite if any silence is allowed."""
        return self.watch.quiet_since + self.watch.after if self.watch.after else math.inf


class TrafficMeter:
    """Measures what one sending half wants to send.

    Attributes:
        offered: messages that the topic wanted to send since the last look, within its own rate limit.
        messages: packed lately; older ones count less.
        bytes: of these.
    """

    def __init__(self, now: float) -> None:
        self.offered = 0
        self.messages = self.bytes = 0.0
        self._size = 0.0
        self._wanted = Smoothed(now)

    @property
    def still(self) -> bool:
        """Whether nothing was offered lately."""
        return not (self.offered or self._wanted.rate)

    def rested(self, until: float) -> None:
        """Take over that nothing was offered until `until` (s)."""
        self._wanted.add(0.0, until)

    def measure(self, now: float) -> float:
        """Return the bytes/s that the topic has wanted to send since the last call. Called once a second."""
        if self.messages:
            self._size = _PER_MESSAGE + self.bytes / self.messages
        self._wanted.add(self.offered, now)
        self.messages *= _SIZE_FADES
        self.bytes *= _SIZE_FADES
        self.offered = 0
        return self._wanted.rate * self._size


class TopicRoute(Route, Generic[ChannelT]):
    """A topic's half on this side.

    Attributes:
        qos: of the bridge's endpoints on both sides, or None if unknown.
        audience: the final subscriptions, as far as this half knows.
        peek_slot: takes the next message for operators who look at the topic.
        lateness: watches for messages that take too long.
    """

    channel: ChannelT | None

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self.qos: Qos | None = None
        self.audience = NOBODY
        self.latency = LatencyMeter(_LATENCY_TICKS)
        self.silence = SilenceWatch(self.log, context.now())
        self.lateness = LateWatch()
        self._flows_since = context.now()
        self._full_at: float | None = None  # s, when the link was last full in this direction
        self.set_stale_after()
        self.peek_slot = PeekSlot(self._new_tap())
        self.traffic = TrafficMeter(context.now())
        self._last_report: SentReport | ReceivedReport | None = None  # the last one of the present opening
        self._logged_ends: tuple[str, str, str] | None = None

    # --- what the halves do differently

    def ledger(self) -> Ledger:
        """Return the ledger: the number of messages by their fate."""
        raise NotImplementedError

    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        """Return the QoS that the original publishers offer, and the QoS that the final subscriptions request."""
        raise NotImplementedError

    @property
    def publisher_nodes(self) -> tuple[str, ...]:
        """Names of the nodes of the original publishers."""
        raise NotImplementedError

    # --- what is the same for both

    def _new_tap(self) -> Tap | None:
        return self.context.tap_of(self.local_topic, self) if self.purpose.in_graph else None

    def renew_tap(self) -> None:
        """Give all messages to another tap from now on, or to none: `Context.tap_of` has changed."""
        self.peek_slot.set_tap(self._new_tap())

    @property
    def present_type(self) -> TypeVersion:
        """The type that nodes of the other side, or publishers of this one, have now; without a name if unknown."""
        raise NotImplementedError

    @property
    def on_end(self) -> str:
        """The message that the receiving side publishes once an arming ends, or an empty string until it names one."""
        return self.on_end_of(self.type_name)

    def on_end_of(self, type_name: str) -> str:
        """Return what it publishes for a type, or an empty string for an unknown one."""
        if not type_name:
            return ""
        own, peer = self._ends_of(type_name)
        receiving, sending = (peer, own) if self.outgoing else (own, peer)
        return agreed_end(receiving, sending, drives=type_name in DRIVING_TYPES)

    def _ends_of(self, type_name: str) -> tuple[str, str]:
        """Return how an arming ends for this side's session and for the peer's, each empty if it says nothing."""
        arming, unset = self.arming, END_ZERO if type_name in DRIVING_TYPES else ""
        return (
            arming.own.on_end or (unset if arming.own.arm else ""),
            arming.peer_on_end or (unset if arming.peer_arm else ""),
        )

    def log_other_end(self, type_name: str) -> None:
        """Log once that the two sessions want different ends of an arming, and which one the robot gets."""
        arming, agreed = self.arming, self.on_end_of(type_name)
        set_here, set_there = arming.own.on_end, arming.peer_on_end
        own, peer = self._ends_of(type_name)
        differs = set_there not in ("", own) or set_here not in ("", agreed)
        ends = (own, peer, agreed) if arming.required and differs else None
        if ends is not None and ends != self._logged_ends:
            text = f"on_end: {own or 'nothing'} here, {peer or 'nothing'} on the other side; the robot gets {agreed}"
            self.log(Level.WARNING, EventCode.ROUTE_OTHER_END, text)
        self._logged_ends = ends

    def open(self, route_id: int) -> None:
        """Begin a new opening on the present connection."""
        super().open(route_id)
        self._last_report = None
        self._full_at = None

    def amend(self, spec: Topic, proposal: Propose) -> None:
        """Change the limits; counts, endpoints and messages in flight stay."""
        super().amend(spec, proposal)
        self.set_stale_after()

    @property
    def _lifespan(self) -> float:
        return 0.0 if self.qos is None else self.qos.lifespan

    def set_stale_after(self) -> None:
        """Watch for silence as the topic's entry and the session say now."""
        self.silence.configure(self.spec, self.context.session)
        self.wake()

    def _may_flow(self) -> None:
        self._flows_since = self.context.now()
        self.silence.rearm(self._flows_since)
        self.lateness.reset()

    @property
    def late_after(self) -> float:
        """Bound (s) that the topic's entry or the session sets now, or 0 for no limit."""
        own = self.spec.late_after
        bound = self.context.session.late_after if own is None else own
        if bound and self.limit.rate and self.is_latched:
            bound += 1 / self.limit.rate  # the rate limit holds the newest message for so long
        return bound

    def late(self) -> Late | None:
        """Return the delay of messages that are late, or None."""
        watch = self.lateness
        if watch.since is None:
            return None
        where, was_full = self._held_up_where(), self.was_full_since(watch.since)
        undecided = self.outgoing and self.context.now() - watch.since < MEASURED_FOR
        return Late(watch.seconds, watch.usual, where, self.link_full, watch.since, was_full, undecided)

    def was_full_since(self, since: float) -> bool:
        """Whether the link was full at some time since `since` (s), and not long ago."""
        return self._full_at is not None and self._full_at >= max(since, self.context.now() - _DRAINS_FOR)

    @property
    def learns(self) -> bool:
        """Whether neither the link is full in this direction nor messages are late or lost.

        A slow publisher is no obstacle: a lower rate becomes the usual one after some time.
        """
        return self.link_full is None and self.lateness.since is None and self.judged.shown_cause not in _UNUSUAL

    def _held_up_where(self) -> str:
        """Return the place where messages are held up, or an empty string if this half does not know it."""
        return ""

    @property
    def _came_here(self) -> int:
        """Messages that came to this half so far, from ROS or the other side."""
        raise NotImplementedError

    def _judge_lateness(self, now: float, *, flows: bool, learns: bool) -> None:
        """Judge `lateness` at `now` (s); `flows`: messages are due."""
        raise NotImplementedError

    def _signs(self) -> Signs:
        return *super()._signs(), self.silence.watch.after

    def _woken(self, since: float) -> None:
        super()._woken(since)
        self.traffic.rested(since)

    def _next_change(self, now: float, crossing: Crossing) -> float:
        if self.lateness.since is not None or not self.traffic.still:
            return now
        changes = [super()._next_change(now, crossing)]
        watch, awaited = self.silence.watch, crossing.flows or self.lacks_publisher(crossing)
        if awaited and self.silence_counts and now < self.silence.due:
            changes.append(self.silence.due)
        if self.judged.announced.verdict.state in _SILENT:
            changes.append(watch.next_warning)
        if self._is_polled:
            # Routes that came together do not wake together.
            changes.append(now + self.context.random.uniform(POLLED_EVERY / 2, POLLED_EVERY))
        return min(changes)

    @property
    def _is_polled(self) -> bool:
        """Whether something may change that is neither one of the signs nor has a time."""
        return self.lossy  # messages that never come whole

    def _measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        self.latency.tick()
        self._judge_lateness(now, flows=crossing.flows, learns=learns)
        self.age.update(self._came_here, now)
        if self.link_full is not None:
            self._full_at = now

    def _follow(self, now: float, crossing: Crossing) -> None:
        awaited = crossing.flows or self.lacks_publisher(crossing)
        if not awaited:
            self.silence.rearm(now)
        shown = self.judged.announced.verdict
        if shown.state in _SILENT:
            self.silence.tick(now, shown.cause)

    def count(self, messages: int, size: int, now: float) -> None:
        """Count messages that pass at `now` (s), of `size` bytes together."""
        if self.idle:
            self.wake()
        # Seldom true, so that nearly every message saves a call.
        if self.notices.last_error:
            self.notices.flowing()
        self.meter.add(messages, size, now)
        self.silence.seen(now)

    @property
    def is_latched(self) -> bool:
        """Whether it is latched, so that no message is due after the first."""
        return self.qos is not None and self.qos.latched

    @property
    def resends(self) -> bool:
        # Kept messages must not get lost. Over datagrams both ends have to agree, and both know only the QoS.
        kept = self.proposal.keep is not None and self.transport.reliable
        return kept or self.qos is None or self.qos.reliability != "best_effort"

    @property
    def came(self) -> bool:
        """Whether messages came in this opening, or the receiving side keeps some of a latched topic."""
        return (self.meter.last is not None and self.meter.last >= self.opened_at) or self.has_kept

    @property
    def came_before(self) -> bool:
        """Whether messages came in an earlier opening, and none in this one."""
        return self.meter.last is not None and not self.came

    @property
    def has_kept(self) -> bool:
        """Whether the receiving side keeps messages of a latched topic from an earlier opening."""
        raise NotImplementedError

    def lacks_publisher(self, crossing: Crossing) -> bool:
        """Whether messages would cross once somebody published: they are missing, too."""
        return False

    @property
    def silence_counts(self) -> bool:
        """Whether this half judges silence by `stale_after`.

        It does if the topic's entry sets `stale_after`, or if messages came at a rhythm. A topic with occasional
        messages may be silent for any time.
        """
        return self.silence.own or (self.meter.regular and not self.is_latched)

    def stale_since(self, crossing: Crossing) -> float | None:
        """Return since when (s) messages that are due have not come, if that is too long ago, or None."""
        if not (crossing.flows or self.lacks_publisher(crossing)):
            return None
        fault, meter, watch = self.peer.path.fault, self.meter, self.silence.watch
        # The sending side cannot say now that its publishers are silent: an expected message waits for the link.
        if fault and fault.cause is LinkCause.SILENT and not self.outgoing and meter.usual_rate and not meter.rate:
            return watch.quiet_since
        return watch.quiet_since if watch.stale(self.context.now()) and self.silence_counts else None

    @property
    def unmatched(self) -> bool:
        """Whether DDS lists endpoints and matches none of them with this half."""
        raise NotImplementedError

    def snapshot(self) -> RouteSnapshot:
        """The route as it is now."""
        publisher_qos, subscriber_qos = self.end_qos()
        return self.common_snapshot()(
            qos=self.qos,
            publisher_qos=publisher_qos,
            subscriber_qos=subscriber_qos,
            ledger=self.ledger(),
            latency_p50=self.latency.p50,
            latency_p99=self.latency.p99,
            jitter=self.latency.jitter,
            publishers=self.publisher_nodes,
            subscribers=self.audience.subscribers,
            audience=self.audience,
        )
