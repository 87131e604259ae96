"""A topic's messages at one end of its route, with the watch of silence and the agreed end of an arming."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rsb_bridge.cdr.known_types import DRIVING_TYPES
from rsb_bridge.model.audience import NOBODY
from rsb_bridge.model.by_hand import END_ZERO, agreed_end
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.motion import may_move
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.drivers import Drivers
from rsb_bridge.route.idling import POLLED_EVERY
from rsb_bridge.route.lateness import LateWatch
from rsb_bridge.route.ledger import OUTAGE, REPLACED
from rsb_bridge.route.peeking import PeekSlot
from rsb_bridge.telemetry.meters import LatencyMeter, StaleWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.model.snapshot import Ledger
    from rsb_bridge.route.half import Carried
    from rsb_bridge.route.peeking import Tap
    from rsb_bridge.route.route import Route

_EXPLAINS = frozenset(
    {
        Cause.NO_PATH,
        Cause.AWAITS_LINK,
        Cause.SUBSCRIBE_FAILED,
        Cause.QOS_INCOMPATIBLE,
        Cause.UNMATCHED,
        Cause.TYPE_CONFLICT,
        Cause.TYPE_UNKNOWN,
        Cause.NO_PUBLISHER,
        Cause.SIMILAR_NAME,
        Cause.PUBLISHED_THERE,
        Cause.PUBLISHER_GONE,
        Cause.TOO_LARGE,
        Cause.NOT_PUBLISHED,
        Cause.LOSSY,
    }
)
"""Causes of silence. Others are silence itself, in other words, or go with messages."""
_LATENCY_LASTS = 10.0  # s of messages that the shown latency is of: so many samples would take minutes at low rates
MEASURED_FOR = 6.0  # s of lateness or loss after which a full link has been noticed
_DRAINS_FOR = 60.0  # s for which messages may be late or lost because their link was full: a round figure
_SILENT = State.STALE, State.STOPPED
# Of commands that were left out. Round figures.
_SETTLED = 3.0  # s without a further one: what was in transit is reported a second after the link is back
_LONGEST = 60.0  # s after which a link that goes on carrying too little is told, too


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
        quiet = self.watch.seen(now)
        if quiet is not None and self._warned:
            self._log(Level.INFO, EventCode.ROUTE_DATA_AGAIN, f"reinitialized: data again after {quiet:.0f} s")
        self._warned = False

    @property
    def due(self) -> float:
        """Time (s) at which it is too long ago, or infinite if any silence is allowed."""
        return self.watch.quiet_since + self.watch.after if self.watch.after else math.inf


class LeftOut:
    """Tells operators of commands that were left out, as they came late or a newer one followed: one line a gap.

    Both sides say the same, as both have the sender's ledger.

    Attributes:
        is_on: whether the topic's messages may not move a robot late.
    """

    is_on = False
    _told = _count = 0
    _since = _grew_at = 0.0

    def __init__(self, route: Route) -> None:
        self._route = route

    @property
    def is_due(self) -> bool:
        """Whether some are not in the log yet."""
        return self._count > self._told

    def judge(self, ledger: Ledger, now: float) -> None:
        """Look at the route's ledger, once a second while commands may be left out."""
        route, peer = self._route, self._route.peer
        count = ledger.expired + ledger.dropped.get(OUTAGE, 0) + ledger.dropped.get(REPLACED, 0)
        was_on, self.is_on = self.is_on, route.age.only_newest
        if not (was_on and self.is_on) or count < self._count:  # or another process has begun to count
            self._told = self._count = count
            return
        if count > self._count:
            if not self.is_due:
                self._since = now
            self._count, self._grew_at = count, now
        lasts = now - self._grew_at < _SETTLED and now - self._since < _LONGEST
        # Until the link carries again, more may be left out.
        if not self.is_due or lasts or not peer.linked or peer.keepalive.in_doubt:
            return
        left_out, self._told = count - self._told, count
        text = f"{left_out:,} late commands left out; max_age: none would have them followed"
        route.log(Level.WARNING, EventCode.ROUTE_COMMANDS_LEFT_OUT, text)


class AgreedEnd:
    """The message that the receiving side publishes once an arming ends, as both sides' sessions want it."""

    def __init__(self, route: Route) -> None:
        self.route = route
        self._logged_ends: tuple[str, str, str] | None = None

    def of(self, type_name: str) -> str:
        """Return what it publishes for a type, or an empty string for an unknown one."""
        if not type_name:
            return ""
        own, peer = self._ends_of(type_name)
        receiving, sending = (peer, own) if self.route.outgoing else (own, peer)
        return agreed_end(receiving, sending, drives=type_name in DRIVING_TYPES)

    def _ends_of(self, type_name: str) -> tuple[str, str]:
        """Return how an arming ends for this side's session and for the peer's, each empty if it says nothing."""
        arming, unset = self.route.arming, END_ZERO if type_name in DRIVING_TYPES else ""
        return (
            arming.own.on_end or (unset if arming.own.arm else ""),
            arming.peer_on_end or (unset if arming.peer_arm else ""),
        )

    def log_other(self, type_name: str) -> None:
        """Log once that the two sessions want different ends of an arming, and which one the robot gets."""
        arming, agreed = self.route.arming, self.of(type_name)
        set_here, set_there = arming.own.on_end, arming.peer_on_end
        own, peer = self._ends_of(type_name)
        differs = set_there not in ("", own) or set_here not in ("", agreed)
        ends = (own, peer, agreed) if arming.required and differs else None
        if ends is not None and ends != self._logged_ends:
            text = f"on_end: {own or 'nothing'} here, {peer or 'nothing'} on the other side; the robot gets {agreed}"
            self.route.log(Level.WARNING, EventCode.ROUTE_OTHER_END, text)
        self._logged_ends = ends


class TopicFlow:
    """A topic's messages at one end of its route: what is typical of them, and what is wrong with them now.

    Attributes:
        carried: of its half.
        qos: of the bridge's endpoints on both sides, or None if unknown.
        audience: the final subscriptions, as far as this half knows.
        end: how an arming ends.
        drivers: the publishers of what moves a robot, on both sides.
        peek_slot: takes the next message for operators who look at the topic.
        lateness: watches for messages that take too long.
        left_out: tells of commands that were not published, as they would have been late.
        flows_since: when (s) messages could cross at last.
        full_at: when (s) the link was last full in this direction in the present opening, or None.
    """

    def __init__(self, route: Route, carried: Carried[Any]) -> None:
        self.route, self.carried = route, carried
        context = route.context
        self.qos: Qos | None
        self.knows("", "", None)
        self.audience = NOBODY
        self.end = AgreedEnd(route)
        self.drivers = Drivers(route, carried)
        route.rested.append(self.drivers.rested)
        self.latency = LatencyMeter(_LATENCY_LASTS)
        self.silence = SilenceWatch(self.route.log, context.now())
        self.lateness = LateWatch()
        self.left_out = LeftOut(route)
        self.flows_since = context.now()
        self.full_at: float | None = None
        self.silence.configure(route.spec, context.session)  # a route that is made is awake
        self.peek_slot = PeekSlot(self._new_tap())
        self.tap_changed: Callable[[], None] = lambda: None

    @property
    def type_name(self) -> str:
        return self.carried.type_name

    @property
    def type_hash(self) -> str:
        return self.carried.type_hash

    def _new_tap(self) -> Tap | None:
        route = self.route
        return route.context.tap_of(route.local_topic, self) if route.purpose.in_graph else None

    def renew_tap(self) -> None:
        """Give all messages to another tap from now on, or to none: `Context.tap_of` has changed."""
        self.peek_slot.set_tap(self._new_tap())
        self.tap_changed()

    def set_stale_after(self) -> None:
        """Watch for silence as the topic's entry and the session say now."""
        self.silence.configure(self.route.spec, self.route.context.session)
        self.route.wake()

    def restart_measuring(self) -> None:
        self.flows_since = self.route.context.now()
        self.silence.rearm(self.flows_since)
        self.lateness.reset()

    @property
    def late_after(self) -> float:
        """Bound (s) that the topic's entry or the session sets now, or 0 for no limit."""
        own = self.route.spec.late_after
        bound = self.route.context.session.late_after if own is None else own
        if bound and self.route.limit.rate and self.is_latched:
            bound += 1 / self.route.limit.rate  # the rate limit holds the newest message for so long
        return bound

    def was_full_since(self, since: float) -> bool:
        """Whether the link was full at some time since `since` (s), and not long ago."""
        return self.full_at is not None and self.full_at >= max(since, self.route.context.now() - _DRAINS_FOR)

    def count(self, messages: int, size: int, now: float) -> None:
        """Count messages that pass at `now` (s), of `size` bytes together."""
        route, meter, watch = self.route, self.route.meter, self.silence.watch
        # Seldom true, so that nearly every message saves three calls.
        if route.idle:
            route.wake()
        if route.notices.last_error:
            route.notices.flowing()
        if watch.warned:
            self.silence.seen(now)
        watch.quiet_since = meter.last = now
        meter.count += messages
        meter.bytes += size

    @property
    def is_latched(self) -> bool:
        """Whether it is latched, so that no message is due after the first."""
        return self.qos is not None and self.qos.latched

    def knows(self, type_name: str, type_hash: str, qos: Qos | None) -> None:
        """Take the type and the QoS of the messages, each empty or None while unknown."""
        carried, route = self.carried, self.route
        carried.type_name, carried.type_hash, self.qos = type_name, type_hash, qos
        carried.may_move = route.purpose.in_graph and may_move(type_name, route.topic, route.remote_topic)

    @property
    def is_whole(self) -> bool:
        """Whether all of its messages are wanted, however late, and not just a state."""
        return self.route.proposal.keep is not None or self.qos is None or self.qos.history == "keep_all"

    def next_change(self, now: float, *, awaited: bool, counts: bool, polled: bool) -> float:
        """Return when (s) something changes by itself next, `now` if it may at any moment, or infinity.

        Args:
            awaited: whether messages are missing if none come.
            counts: whether this half judges silence.
            polled: whether something may change that is neither one of the signs nor has a time.
        """
        if self.lateness.since is not None or self.left_out.is_due:
            return now
        changes = [math.inf]
        if awaited and counts and now < self.silence.due:
            changes.append(self.silence.due)
        if self.route.judged.announced.verdict.state in _SILENT:
            changes.append(self.silence.watch.next_warning)
        if polled or self.route.lossy:  # messages that never come whole
            # Routes that came together do not wake together.
            changes.append(now + self.route.context.random.uniform(POLLED_EVERY / 2, POLLED_EVERY))
        return min(changes)

    def is_well(self, now: float) -> bool:
        """Whether its messages are neither late nor missing."""
        late = self.lateness.since is not None or self.route.age.late() is not None
        return not late and not self.silence.watch.stale(now) and not self.route.notices.undelivered

    def goes_on(self, now: float, delay: float) -> bool:
        """Whether no message is late or missing, and none may move a robot or become too old, as far as counts tell.

        Args:
            delay: s that messages take now.
        """
        route, peer, bound, watch = self.route, self.route.peer, self.lateness.bound, self.silence.watch
        return bool(
            (not bound or (delay <= bound and self.lateness.is_decided))
            and (not watch.after or now - watch.quiet_since < watch.after)
            and not (self.carried.may_move or route.arming.required or route.age.is_on or self.left_out.is_on)
            and peer.path.fault is None and peer.fullness.out is None and peer.fullness.into is None
        )  # fmt: skip

    def is_calm(self, now: float) -> bool:
        """Whether no message of the last seconds counts any more, and no operator has looked at them."""
        calm = self.latency.is_blank and self.lateness.is_decided and self.route.age.is_calm and self.drivers.are_calm
        return calm and not self.left_out.is_due and not self.peek_slot.is_used(now)

    def act(self, now: float, *, awaited: bool) -> None:
        """Do what follows from the new verdict."""
        if not awaited:
            self.silence.rearm(now)
        shown = self.route.judged.announced.verdict
        if shown.state in _SILENT:
            self.silence.tick(now, shown.cause)

    @property
    def silence_counts(self) -> bool:
        """Whether silence is judged by `stale_after`.

        It is if the topic's entry sets `stale_after`, or if messages came at a rhythm. A topic with occasional
        messages may be silent for any time.
        """
        return self.silence.own or (self.route.meter.regular and not self.is_latched)
