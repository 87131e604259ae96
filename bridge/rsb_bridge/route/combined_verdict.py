"""The combined verdict of the two sides of a route, for the screens and the logs of both."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.text import join_first, sanitize_text
from rsb_bridge.model.verdict import FINE, Cause, Verdict, worse
from rsb_bridge.wire.records import VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from rsb_bridge.model.faults import PathFault
    from rsb_bridge.ros.ros_interface import Endpoint

_SAME_ON_BOTH = frozenset(
    {
        Cause.LINK_DOWN, Cause.AWAITS_LINK, Cause.REFUSED, Cause.LISTED_DIFFERENTLY, Cause.PAUSED, Cause.DISARMED,
    }
)  # fmt: skip
"""Causes that each side knows for itself."""
_ENOUGH_SAID_HERE = frozenset(
    {
        Cause.NONE, Cause.NO_MESSAGE, Cause.SILENT, Cause.THROTTLED, Cause.NO_CALL, Cause.UNANSWERED, Cause.CALLS_WAIT,
        Cause.CALLS_REFUSED, Cause.SEVERAL_PUBLISHERS, Cause.RESTING,
    }
)  # fmt: skip
"""Causes of which the other side knows no more, if it has the same."""
_OF_NODE = (Cause.UNANSWERED, Cause.CALLS_WAIT)
"""Causes that the providing side can tell from a lossy path."""
NAMED = 3
"""Nodes that a sentence names."""
# Of reports, which have room for a thousand routes.
_TEXT_LENGTH = 300  # characters of a text
NODES, NODE_LENGTH = 4, 64  # the most nodes, and characters of their names
_LONGEST = 1e9  # s, 30 years: a peer that says more makes it up
_JITTER = 2.0  # s by which two reports on one fault may be apart, or its time would jump with each: a round figure

# Of the log. Those without a source are round figures.
_LASTS = 3.0  # s that a verdict must last: with a tenth of it, each second that goes wrong would be logged
_LOSS_LASTS = 7.0  # s that a loss on the way must last: before that, its remedy is not known (`MEASURED_FOR`)
_WAITS = 10.0  # s that a route waits before the log reports it: nodes that start with the bridge are up by then
_AGAIN_AFTER = 60.0  # s until a verdict is repeated: with a tenth of it, a topic that comes and goes would fill the log
_MOST_LOGGED = 32  # verdicts remembered for that
_MENDABLE: dict[str, Level] = {
    Cause.NO_PUBLISHER: Level.INFO,
    Cause.NO_SERVER: Level.INFO,
    Cause.SIMILAR_NAME: Level.WARNING,
    Cause.PUBLISHED_THERE: Level.WARNING,
    Cause.TYPE_UNKNOWN: Level.WARNING,
    Cause.PUBLISHER_UNHEARD: Level.WARNING,
}
"""What a route may wait for that a person can mend: a name or a type that is typed wrong, a type to install, DDS."""
_LOGGED_ELSEWHERE = frozenset(
    {
        Cause.LINK_DOWN, Cause.REFUSED, Cause.LISTED_DIFFERENTLY, Cause.LOOP, Cause.PAUSED, Cause.DISARMED,
        Cause.DISARMING, Cause.SUBSCRIBE_FAILED, Cause.SILENT, Cause.NO_MESSAGE,
    }
)  # fmt: skip
"""Causes that have events of their own, on both sides."""
_ANNOUNCED = frozenset({State.DOWN, State.STALE, State.STOPPED, State.LATE, State.SLOW, State.UNHEARD})


class Shown(NamedTuple):
    """The verdict for operators of this side.

    Attributes:
        verdict: the worse of both; if it is the other side's, its text names that side.
        from_peer: whether it is the other side's.
    """

    verdict: Verdict
    from_peer: bool


class CombinedVerdict:
    """Puts both sides' verdicts together.

    Attributes:
        peer: the other side's.
        announced: the verdict for operators at the last `announce`.
        shown_cause: the cause that was shown last, or an empty string.
    """

    def __init__(self, *, sends: bool, peer_name: str) -> None:
        self.peer = FINE
        self.announced = Shown(FINE, from_peer=False)
        self._sends = sends
        self._peer_name = peer_name
        self._announcer = Announcer()
        self.shown_cause: str = Cause.NONE
        self._shows: tuple[State, str] | None = None
        self._since = 0.0

    def receive(self, record: VerdictRecord | None, now: float) -> None:
        """Take the other side's verdict, which came at `now` (s)."""
        if record is None:
            self.peer = FINE
            return
        state = State(record.state)
        since, before = _since(record.lasting, now), self.peer
        same = (before.state, before.cause) == (state, record.cause)
        # Reports take different times to arrive.
        if same and before.since is not None and abs(since - before.since) < _JITTER:
            since = before.since
        self.peer = Verdict(state, record.cause, record.text, since)

    def shown(self, own: Verdict) -> Shown:
        """Return the verdict that counts, given this side's."""
        same = (own.state, own.cause) == (self.peer.state, self.peer.cause)
        if own.cause in _SAME_ON_BOTH or (same and own.cause in _ENOUGH_SAID_HERE):
            return Shown(own, from_peer=False)
        # In the same order on both sides, so that both show the same one of two that are equally bad.
        sender, receiver = (own, self.peer) if self._sends else (self.peer, own)
        verdict, from_sender = worse(sender, receiver)
        # The calling side cannot tell a lossy path from a node that does not answer; the other side can.
        if verdict.cause == Cause.LOSSY and receiver.state is verdict.state and receiver.cause in _OF_NODE:
            verdict, from_sender = receiver, False
        if from_sender == self._sends:
            return Shown(verdict, from_peer=False)
        text = f"{self._peer_name}: {verdict.text}" if verdict.text else ""
        return Shown(replace(verdict, text=text), from_peer=True)

    def announce(self, own: Verdict, now: float, path: PathFault | None = None) -> StateEvent | None:
        """Return the event to log, if any; a fault of the link's path is logged once, for the link.

        Called once a second.
        """
        self.announced = self.shown(own)
        verdict = self.announced.verdict
        self.since(verdict, now)  # which notes the cause that is shown, whether anything is logged or not
        if path is not None and path.of_topic(verdict.cause) is not None:
            return None
        return self._announcer.announce(verdict, now)

    @property
    def next_change(self) -> float:
        """Time (s) at which a verdict that lasts is logged, or infinite."""
        return self._announcer.next_change

    def since(self, verdict: Verdict, now: float) -> float:
        """Return the beginning (s) of the state and cause of `verdict`, which is shown at `now` (s).

        It is the beginning that the verdict names, or the moment when it was first shown.
        """
        shows = (verdict.state, verdict.cause)
        if shows != self._shows:
            self._shows, self.shown_cause = shows, verdict.cause
            self._since = now if verdict.since is None else verdict.since
        return self._since


def record_of(verdict: Verdict) -> VerdictRecord | None:
    """Return a verdict's record for the other side without its duration, or None if nothing is wrong."""
    if verdict == FINE:
        return None
    # With its duration, each report would differ from the one before, and be sent.
    return VerdictRecord(verdict.state, verdict.cause, sanitize_text(verdict.text, _TEXT_LENGTH))


def lasting(record: VerdictRecord | None, verdict: Verdict, now: float) -> VerdictRecord | None:
    """Return the record of a verdict, and how long it has lasted at `now` (s)."""
    if record is None or verdict.since is None:
        return record
    return msgspec.structs.replace(record, lasting=now - verdict.since)


def _since(seconds: float, now: float) -> float:
    """Since when something lasts, if it can have lasted as long as the other side says."""
    return now - seconds if 0.0 <= seconds <= _LONGEST else now


def node_names(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    """Return the names of the nodes with these endpoints, as reports to the other side list them."""
    names = sorted({each.node for each in endpoints if each.node})
    return tuple([sanitize_text(name, NODE_LENGTH) for name in names[:NODES]])


def named(nodes: Iterable[str]) -> str:
    """``/a``, ``/a and /b``, ``/a, /b, /c and 2 more``."""
    return join_first(sorted({node or "a node that is not known yet" for node in nodes}), NAMED) or "nobody"


def who_publish(nodes: Collection[str]) -> str:
    """``/a publishes``, ``/a and /b publish``."""
    return f"{named(nodes)} {'publishes' if len(nodes) == 1 else 'publish'}"


def nodes_by(what: Literal["type_name", "type_hash"], endpoints: Iterable[Endpoint]) -> dict[str, set[str]]:
    """Group endpoints' nodes by an attribute of the endpoint. Endpoints without it are left out."""
    nodes: dict[str, set[str]] = {}
    for each in endpoints:
        if key := getattr(each, what):
            nodes.setdefault(key, set()).add(each.node)
    return dict(sorted(nodes.items()))


class StateEvent(NamedTuple):
    """An event."""

    level: Level
    code: EventCode
    text: str
    cause: str


class Announcer:
    """Decides what the log says of a route's verdicts: each turn for the worse that lasts, and when it is over.

    Called once a second.

    Attributes:
        next_change: time (s) at which a verdict that lasts is told or repeated, or infinite.
    """

    def __init__(self) -> None:
        self.next_change = math.inf
        self._candidate = FINE
        self._since = float("-inf")
        self._bad_since: float | None = None
        self._logged = FINE
        self._logged_as: tuple[EventCode, str] | None = None
        self._logged_at: dict[tuple[EventCode, str], float] = {}
        self._heard = False

    def announce(self, verdict: Verdict, now: float) -> StateEvent | None:
        """Return the event to log about the verdict at `now` (s), if any."""
        self.next_change = math.inf
        if (verdict.state, verdict.cause) != (self._candidate.state, self._candidate.cause):
            self._since = now
        self._candidate = verdict
        if verdict.state not in _ANNOUNCED:
            self._bad_since = None
        elif self._bad_since is None:
            self._bad_since = now
        # What changes its cause again and again lasts, too.
        flaps_at = math.inf if self._logged_as or self._bad_since is None else self._bad_since + _LOSS_LASTS
        lasts_at = self._since + (_LOSS_LASTS if verdict.cause == Cause.LOSSY else _LASTS)
        if now < (due := min(lasts_at, flaps_at)):
            # Most of what a route waits for is never logged.
            is_logged = verdict.state is not State.WAITING or verdict.cause in _MENDABLE
            self.next_change = due if is_logged else math.inf
            return None
        if verdict.state is State.OK:
            self._heard = True
            notes = verdict.cause == Cause.SEVERAL_PUBLISHERS
            if notes and self._logged.state is State.OK:
                return self._say(Level.INFO, EventCode.ROUTE_SEVERAL_PUBLISHERS, verdict, now)
            logged, self._logged, self._logged_as = self._logged, FINE, None
            if logged.state is State.OK:
                return None
            return StateEvent(Level.INFO, EventCode.ROUTE_RECOVERED, f"no longer {logged.state}", logged.cause)
        if verdict.state is State.WAITING:
            return self._waiting(verdict, now)
        if verdict.state not in _ANNOUNCED or verdict.cause in _LOGGED_ELSEWHERE:
            return None
        if verdict.cause == Cause.NO_SUBSCRIBER and not self._heard:
            return None  # nobody has been there yet, which the screen shows
        return self._say(Level.WARNING, EventCode.ROUTE_FAULT, verdict, now)

    def _waiting(self, verdict: Verdict, now: float) -> StateEvent | None:
        level = _MENDABLE.get(verdict.cause)
        if level is None:
            return None
        if now < (due := self._since + _WAITS):
            self.next_change = due
            return None
        return self._say(level, EventCode.ROUTE_WAITING, verdict, now)

    def _say(self, level: Level, code: EventCode, verdict: Verdict, now: float) -> StateEvent | None:
        what = code, verdict.cause
        if what == self._logged_as:
            return None
        again_at = self._logged_at.get(what, -math.inf) + _AGAIN_AFTER
        if now < again_at:
            self.next_change = again_at
            return None
        self._logged, self._logged_as = verdict, what
        if len(self._logged_at) >= _MOST_LOGGED:  # a peer may make up causes
            self._logged_at.clear()
        self._logged_at[what] = now
        state = "" if verdict.state is State.OK else f"{verdict.state.upper()}: "
        return StateEvent(level, code, f"{state}{verdict.said(now)}", verdict.cause)
