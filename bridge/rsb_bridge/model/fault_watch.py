"""Finds the faults that last in a series of snapshots: when each begins, changes and is over."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from rsb_bridge.model.health import link_is_wrong, route_is_wrong
from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, State

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.snapshot import Snapshot

LASTS = 2.0
"""s for which a fault lasts before it is reported, and is gone before its end is reported."""

_Key = tuple[str, str]
_Kind = tuple[str, str]
"""State and cause."""


class ChangeKind(StrEnum):
    """Kind of a fault's change."""

    BEGUN = "begun"
    CHANGED = "changed"
    """Its state or its cause differs from the last report."""
    OVER = "over"


@dataclass(frozen=True, slots=True)
class FaultChange:
    """A change of one link's or route's fault.

    Attributes:
        kind: of the change.
        subject: the newest snapshot of the link or the route.
        removed: whether the link or the route was removed.
        before: the state and the cause of the last report; of a fault that has begun, the earlier ones, or empty.
    """

    kind: ChangeKind
    subject: LinkSnapshot | RouteSnapshot
    removed: bool = False
    before: _Kind = ("", "")

    @property
    def key(self) -> _Key:
        """Identifies the link or the route."""
        return _key(self.subject)


@dataclass(slots=True)
class _Watched:
    """A link or a route with a fault, past or present.

    Attributes:
        subject: its newest snapshot.
        since: s, when the fault began; once it is reported, when `next` began.
        reported: the state and cause of the last report, or None before the first.
        next: the state and cause to report next, or None for the fault's end; used after the first report.
        before: the state before the fault began.
    """

    subject: LinkSnapshot | RouteSnapshot
    since: float
    before: _Kind
    reported: _Kind | None = None
    next: _Kind | None = None


class FaultWatch:
    """Follows the faults of one bridge. It reads no clock: the caller passes the time in.

    While a link is not up, its routes' faults neither begin nor end: the link's own fault explains them.

    Args:
        lasts: s, as `LASTS`.
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
        down = _names_of_down(snapshot)
        links = [link for link in snapshot.links if link_is_wrong(link)]
        routes = [route for route in snapshot.routes if route.link not in down and route_is_wrong(route)]
        wrong: tuple[LinkSnapshot | RouteSnapshot, ...] = (*links, *routes)
        for subject in wrong:
            kind = _kind(subject)
            self._watched[_key(subject)] = _Watched(subject, now, ("", ""), kind, kind)

    def look(self, snapshot: Snapshot, now: float) -> list[FaultChange]:
        """Return the changes to report since the snapshots before, at `now` (s on a monotonic clock)."""
        found = [*self._changes(snapshot, now)]
        subjects: tuple[LinkSnapshot | RouteSnapshot, ...] = (*snapshot.links, *snapshot.routes)
        self._well = {_key(each): _kind(each) for each in subjects if _key(each) not in self._watched}
        return found

    def _changes(self, snapshot: Snapshot, now: float) -> Iterator[FaultChange]:
        down = _names_of_down(snapshot)
        seen: set[_Key] = set()
        for link in snapshot.links:
            seen.add(_key(link))
            yield from self._look_at(link, now, is_wrong=link_is_wrong(link))
        for route in snapshot.routes:
            seen.add(_key(route))
            if route.link in down:
                self._suspend(route)
            else:
                yield from self._look_at(route, now, is_wrong=route_is_wrong(route))
        for key in [key for key in self._watched if key not in seen]:
            yield from self._look_at(self._watched[key].subject, now, is_wrong=False, removed=True)

    def _look_at(
        self, subject: LinkSnapshot | RouteSnapshot, now: float, *, is_wrong: bool, removed: bool = False
    ) -> Iterator[FaultChange]:
        key = _key(subject)
        watched = self._watched.get(key)
        if watched is None:
            if is_wrong:
                self._watched[key] = _Watched(subject, now, self._well.get(key, ("", "")))
            return
        watched.subject = subject
        kind = _kind(subject) if is_wrong else None
        if watched.reported is None:
            if not is_wrong:
                del self._watched[key]
            elif now - watched.since >= self._lasts:
                watched.reported = watched.next = kind
                yield FaultChange(ChangeKind.BEGUN, subject, before=watched.before)
            return
        if kind != watched.next:
            watched.next, watched.since = kind, now
        if kind == watched.reported or now - watched.since < self._lasts:
            return
        before, watched.reported = watched.reported, kind
        if kind is None:
            del self._watched[key]
            yield FaultChange(ChangeKind.OVER, subject, removed, before)
        else:
            yield FaultChange(ChangeKind.CHANGED, subject, before=before)

    def _suspend(self, route: RouteSnapshot) -> None:
        """Restart the time for which a route's fault has lasted or been gone."""
        watched = self._watched.get(_key(route))
        if watched is None:
            return
        if watched.reported is None:
            del self._watched[_key(route)]
        else:
            watched.next = watched.reported


def _names_of_down(snapshot: Snapshot) -> set[str]:
    return {link.name for link in snapshot.links if link.state is not State.OK}


def _key(subject: LinkSnapshot | RouteSnapshot) -> _Key:
    return ("link", subject.name) if isinstance(subject, LinkSnapshot) else ("route", subject.key)


def _kind(subject: LinkSnapshot | RouteSnapshot) -> _Kind:
    return str(subject.state), subject.cause
