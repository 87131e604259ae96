"""Faults of links, routes and patterns: which states are any, when they begin and end, and which a path explains."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.snapshot import LinkSnapshot, PatternSnapshot, RouteSnapshot, State
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.snapshot import Snapshot

Faulty: TypeAlias = LinkSnapshot | RouteSnapshot | PatternSnapshot

_NOTHING_WRONG = frozenset({State.WAITING, State.OK, *(state for state in State if state.is_wanted)})


def state_counts(things: Iterable[RouteSnapshot | LinkSnapshot]) -> dict[State, int]:
    """Count the routes or links in each state, the worst first. A console, a fleet and `status` all show this.

    Empty states and acknowledged faults are left out.
    """
    counts = Counter(thing.state for thing in things if thing.acknowledged is None)
    return {state: counts[state] for state in State if counts[state]}


def is_wrong(subject: Faulty) -> bool:
    """Whether a link, a route or a pattern has a fault.

    None has a link that waits for its first connection, an unused route, one in a state that an operator wants, and a
    pattern that matches nothing.
    """
    if isinstance(subject, LinkSnapshot) and subject.warning:
        return True
    if isinstance(subject, RouteSnapshot) and subject.state is State.UNHEARD:
        return subject.cause != Cause.NO_SUBSCRIBER
    waits = isinstance(subject, RouteSnapshot) and route_waits(subject)
    return subject.state not in _NOTHING_WRONG and not waits


def needs_attention(subject: Faulty) -> bool:
    """Whether it has a fault that no operator has acknowledged."""
    return subject.acknowledged is None and is_wrong(subject)


def fault_count(now: Snapshot) -> int:
    """Count the faults that no operator has acknowledged: a link that is down once, and not for each of its topics."""
    if not now.running:
        return 1
    down = {link.name for link in now.links if link.state is not State.OK}
    patterns = sum(needs_attention(pattern) for link in now.links for pattern in link.patterns)
    routes = sum(needs_attention(route) for route in now.routes if route.link not in down)
    return sum(map(needs_attention, now.links)) + patterns + routes


def route_waits(route: RouteSnapshot) -> bool:
    """Whether it waits for its first message and its entry sets no limit on the wait."""
    if route.state is State.STALE:
        return route.last_at is None and not route.spec.stale_after
    return route.state is State.WAITING


class PathFaultText(Wording):
    LOSSY = "{share} of packets are lost {way} {peer}: check its Wi-Fi or cable"
    LARGE_PACKETS = (
        "large packets are lost {way} {peer}, small ones arrive: "
        "lower the MTU on both sides (ip link set DEVICE mtu 1280)"
    )
    SILENT = "nothing comes from {peer} now: check that it is on, its cable or Wi-Fi, and firewalls"
    HELD = "nothing comes on the connection with {peer}, other data does: check firewalls and proxies"
    GONE = "the path to {peer} is in order again"


_LOST = frozenset(
    {
        Cause.NO_PATH, Cause.LOSSY, Cause.LATE, Cause.LINK_SLOW, Cause.CLOCK_UNKNOWN, Cause.QUEUE_FULL,
        Cause.SILENT, Cause.UNANSWERED,
    }
)  # fmt: skip
_OF_TOPICS = {
    LinkCause.LOSSY: (Cause.LOSSY, _LOST),
    LinkCause.LARGE_PACKETS: (Cause.NO_PATH, frozenset({Cause.NO_PATH, Cause.LOSSY})),
    LinkCause.SILENT: (Cause.AWAITS_LINK, _LOST | {Cause.AWAITS_LINK}),
}
"""By the cause of a link that is up: the cause of topics that suffer from it, and the causes that it replaces."""


class PathFault(NamedTuple):
    """A fault of a link's path while the link is up."""

    cause: LinkCause  # `LinkCause.LOSSY`, `LARGE_PACKETS` or `SILENT`
    text: str  # for an operator, with the remedy

    def of_topic(self, cause: str) -> Cause | None:
        """Return the cause to show instead of a topic's own, or None if the path does not explain that."""
        shown, explained = _OF_TOPICS[self.cause]
        return shown if cause in explained else None


def explained_by_link(cause: str, link: LinkSnapshot | None) -> bool:
    """Whether a route's fault of that cause is its link's, so that one report is enough."""
    if cause == Cause.LINK_DOWN:
        return True
    if link is None or link.cause not in _OF_TOPICS:
        return False
    return cause == _OF_TOPICS[LinkCause(link.cause)][0]


_OF_MESSAGES = frozenset({State.STALE, State.STOPPED, State.LATE, State.SLOW})
"""States of which only a message, or an answer, proves the end."""
_NOTHING_COMES = frozenset(
    {Cause.LOSSY, Cause.TOO_LARGE, Cause.QUEUE_FULL, Cause.NOT_PUBLISHED, Cause.SERVER_GONE}
)  # fmt: skip
"""The same: causes of the state `DOWN`."""
_NO_NEWS = frozenset({Cause.NO_MESSAGE, Cause.SILENT, Cause.AWAITS_LINK})
"""Causes of a topic that waits which say less than the causes of its fault."""

LASTS = 2.0  # seconds that a fault must last before it is reported, and be gone before its end is reported

_Key: TypeAlias = tuple[str, str]
_Kind: TypeAlias = tuple[str, str]  # state and cause


class ChangeKind(StrEnum):
    BEGUN = "begun"
    CHANGED = "changed"
    """Its state or its cause differs from the last report."""
    OVER = "over"


@dataclass(frozen=True, slots=True)
class FaultChange:
    """A change of the fault of a link, a route or a pattern."""

    kind: ChangeKind
    subject: Faulty  # the newest snapshot of the link, the route or the pattern
    removed: bool = False
    before: _Kind = ("", "")
    """The state and the cause of the last report; of a fault that has begun, the earlier ones, or empty."""
    seen: float = 0.0  # s since the epoch, the first snapshot with the reported state and cause

    @property
    def key(self) -> _Key:
        """Identifies the link, the route or the pattern."""
        return _key(self.subject)


@dataclass(slots=True)
class _Watched:
    """A link, a route or a pattern with a fault, past or present."""

    subject: Faulty
    since: float  # s, when the fault began; once it is reported, when `next` began
    seen: float  # the same in s since the epoch
    before: _Kind  # the state before the fault began
    reported: _Kind | None = None  # the state and cause of the last report, or None before the first
    next: _Kind | None = None
    """The state and cause to report next, or None for the fault's end; used after the first report."""
    owes: bool = False  # whether a fault of a topic's messages was reported, so that only a message proves its end
    well_since: float | None = None  # s, before the first report: since when nothing is wrong, or None

    def report(self, kind: _Kind) -> None:
        """Take note that a state and a cause are reported."""
        self.reported = self.next = kind
        state, cause = kind
        # Of messages or calls, and not of a condition for any to cross.
        self.owes |= state in _OF_MESSAGES or (state == State.DOWN and cause in _NOTHING_COMES)

    def present(self) -> _Kind | None:
        """Return the state and the cause now, or None if nothing is wrong. A wait without news is as reported."""
        subject = self.subject
        if is_wrong(subject):
            return _kind(subject)
        # A topic that waits for a message, or a service for a server; one that can be called owes nothing.
        waits = isinstance(subject, RouteSnapshot) and route_waits(subject) and subject.cause != Cause.NO_CALL
        if not (self.owes and waits):
            return None
        assert self.reported is not None
        news = subject.cause not in _NO_NEWS and subject.cause != self.reported[1]
        return _kind(subject) if news else self.reported


class FaultWatch:
    """Follows the faults of one bridge. It reads no clock: the caller passes the time in.

    While a link is not up, faults of its routes and patterns neither begin nor end: the link's own fault explains them.
    So it does while its path loses packets, for the routes that suffer from it.

    A topic whose messages failed waits when its link comes back, since nothing is due in the new opening. That is no
    recovery: its fault lasts until a message crosses, or the topic is paused, disarmed or removed.
    """

    def __init__(self, lasts: float = LASTS) -> None:
        self._lasts = lasts
        self._watched: dict[_Key, _Watched] = {}
        self._well: dict[_Key, _Kind] = {}

    @property
    def ongoing(self) -> int:
        """Number of faults that were reported and are not over."""
        return sum(each.reported is not None for each in self._watched.values())

    def assume(self, snapshot: Snapshot, now: float) -> None:
        """Treat the faults of a snapshot at `now` (s) as reported already."""
        for subject, explained in _subjects(snapshot):
            if is_wrong(subject) and not explained:
                watched = self._watched[_key(subject)] = _Watched(subject, now, snapshot.time, ("", ""))
                watched.report(_kind(subject))

    def find_changes(self, snapshot: Snapshot, now: float) -> list[FaultChange]:
        """Return the changes to report since the snapshots before, at `now` (s on a monotonic clock)."""
        found: list[FaultChange] = []
        seen: dict[_Key, _Kind] = {}
        for subject, explained in _subjects(snapshot):
            seen[_key(subject)] = _kind(subject)
            if explained:
                self._suspend(_key(subject))
            else:
                found += self._look_at(subject, now, snapshot.time)
        for key in [key for key in self._watched if key not in seen]:
            found += self._look_at(self._watched[key].subject, now, snapshot.time, removed=True)
        self._well = {key: kind for key, kind in seen.items() if key not in self._watched}
        return found

    def _look_at(self, subject: Faulty, now: float, time: float, *, removed: bool = False) -> Iterator[FaultChange]:
        key = _key(subject)
        watched = self._watched.get(key)
        if watched is None:
            if is_wrong(subject):
                self._watched[key] = _Watched(subject, now, time, self._well.get(key, ("", "")))
            return
        watched.subject = subject
        kind = None if removed else watched.present()
        # Until the first report, neither another cause nor a moment without a fault restarts the time: what flaps is a
        # fault, too.
        if watched.reported is None:
            if kind is None:
                watched.well_since = now if watched.well_since is None else watched.well_since
                if removed or now - watched.well_since >= self._lasts:
                    del self._watched[key]
                return
            watched.well_since = None
            if now - watched.since >= self._lasts:
                watched.report(kind)
                yield FaultChange(ChangeKind.BEGUN, subject, before=watched.before, seen=watched.seen)
            return
        if kind != watched.next:
            watched.next, watched.since, watched.seen = kind, now, time
        if kind == watched.reported or now - watched.since < self._lasts:
            return
        before = watched.reported
        if kind is None:
            del self._watched[key]
            yield FaultChange(ChangeKind.OVER, subject, removed, before, watched.seen)
        else:
            watched.report(kind)
            yield FaultChange(ChangeKind.CHANGED, subject, before=before, seen=watched.seen)

    def _suspend(self, key: _Key) -> None:
        """Restart the time for which a fault has lasted or been gone."""
        watched = self._watched.get(key)
        if watched is not None and watched.reported is None:
            del self._watched[key]
        elif watched is not None:
            watched.next = watched.reported


def _subjects(snapshot: Snapshot) -> Iterator[tuple[Faulty, bool]]:
    """Yield all links, routes and patterns, and whether the fault of its link explains what is wrong with each."""
    links = {link.name: link for link in snapshot.links}
    parts: list[RouteSnapshot | PatternSnapshot] = [*snapshot.routes]
    for link in snapshot.links:
        yield link, False
        parts += link.patterns
    for part in parts:
        its_link = links.get(part.link)
        is_down = its_link is not None and its_link.state is not State.OK
        yield part, is_down or explained_by_link(part.cause, its_link)


def _key(subject: Faulty) -> _Key:
    if isinstance(subject, LinkSnapshot):
        return "link", subject.name
    return "route" if isinstance(subject, RouteSnapshot) else "pattern", subject.key


def _kind(subject: Faulty) -> _Kind:
    return str(subject.state), subject.cause
