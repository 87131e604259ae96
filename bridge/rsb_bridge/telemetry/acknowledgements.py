"""Acknowledged faults, each until it becomes another one or is over."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.faults import explained_by_link
from rsb_bridge.model.snapshot import Acknowledgement, Level, LinkSnapshot, PatternSnapshot, RouteSnapshot, State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.snapshot import Snapshot
    from rsb_bridge.telemetry.event_log import EventLog

_TOLERANCE = 2.0  # s by which the beginning of a state may be wrong, because the wall clock is adjusted
# Causes of one fault: DDS lists a publisher for up to 20 s after its process was killed.
_ONE_FAULT = frozenset({Cause.PUBLISHER_SILENT, Cause.PUBLISHER_UNHEARD, Cause.PUBLISHER_GONE})
# Unlike in `model.faults`, WAITING is a fault here: an operator may acknowledge what a topic waits for.
_NO_FAULT = frozenset({State.OK, *(state for state in State if state.is_wanted)})

AnyFaulty: TypeAlias = RouteSnapshot | LinkSnapshot | PatternSnapshot
Faulty = TypeVar("Faulty", RouteSnapshot, LinkSnapshot, PatternSnapshot)


class _AcknowledgedFault(NamedTuple):
    """One acknowledged fault.

    Attributes:
        state: of the route or the link, when it was acknowledged.
        at: s on the steady clock, the time of the acknowledgement.
    """

    state: State
    cause: str
    record: Acknowledgement
    at: float


class Acknowledgements:
    """Marks the acknowledged faults of each snapshot, and forgets them once they are over, which bounds its size."""

    def __init__(self, clock: Clock, events: EventLog) -> None:
        self._clock = clock
        self._events = events
        self._known: dict[tuple[str, str], _AcknowledgedFault] = {}
        self._marked: dict[tuple[str, str], tuple[Any, Any]] = {}
        """The newest marked snapshots, each with its original, so that an unchanged one stays the same object."""

    def add(self, faulty: AnyFaulty, by: str) -> None:
        """Acknowledge a fault.

        Raises:
            ValueError: it has no fault.
        """
        if not has_fault(faulty):
            raise ValueError(f"{_name(faulty)} has no fault to acknowledge")
        record = Acknowledgement(by, self._clock.time_ns() / 1e9)
        self._known[_key(faulty)] = _AcknowledgedFault(faulty.state, faulty.cause, record, self._clock.steady())

    def remove(self, faulty: AnyFaulty) -> None:
        """Take an acknowledgement back.

        Raises:
            ValueError: it is not acknowledged.
        """
        if self._known.pop(_key(faulty), None) is None:
            raise ValueError(f"{_name(faulty)} has no acknowledged fault")

    def mark(
        self, links: Iterable[LinkSnapshot], routes: Iterable[RouteSnapshot], now: float
    ) -> tuple[tuple[LinkSnapshot, ...], tuple[RouteSnapshot, ...]]:
        """Mark acknowledged faults, and forget changed ones. A link's covers the routes that suffer from its fault.

        Args:
            now: s since the epoch.
        """
        links, routes = tuple(links), tuple(routes)
        # Nearly always: then no snapshot is copied.
        if not self._known:
            self._marked.clear()
            return links, routes
        patterns = (pattern for link in links for pattern in link.patterns)
        every: tuple[AnyFaulty, ...] = (*links, *patterns, *routes)
        # A fault that this snapshot does not have is forgotten.
        self._known = {_key(each): kept for each in every if (kept := self._kept(each, now)) is not None}
        before, self._marked = self._marked, {}
        new_links = tuple(self._marked_link(link, before) for link in links)
        by_name = {link.name: link for link in new_links}
        new_routes = []
        for route in routes:
            record, link = self._record(route), by_name.get(route.link)
            if record is None and link is not None and explained_by_link(route.cause, link):
                record = link.acknowledged
            new_routes.append(route if record is None else self._copy(route, before, record))
        return new_links, tuple(new_routes)

    def _kept(self, faulty: AnyFaulty, now: float) -> _AcknowledgedFault | None:
        """Return what is known of a fault, unless it is over or has become another one."""
        known = self._known.get(_key(faulty))
        if known is None:
            return None
        if not _is_fault(faulty, known.state, known.cause):
            # A fault that is over needs no operator; one that became another one counts again.
            if has_fault(faulty):
                self._log_end(faulty)
            return None
        # Another cause restarts the state's time, so the comparison below has to restart, too: a killed publisher is
        # silent, and gone some 20 s later.
        if known.cause != faulty.cause:
            return known._replace(cause=faulty.cause, at=self._clock.steady())
        if not isinstance(faulty, PatternSnapshot):  # a pattern has no `since`
            since = faulty.fault_since if isinstance(faulty, LinkSnapshot) else faulty.since
            lasting, elapsed = now - since, self._clock.steady() - known.at
            if lasting + _TOLERANCE < elapsed:  # it was over meanwhile, and began again
                self._log_end(faulty)
                return None
        return known

    def _log_end(self, faulty: AnyFaulty) -> None:
        text = f"acknowledgement ended, the fault is now {faulty.state.upper()}"
        text += f" ({faulty.cause})" if faulty.cause else ""
        link, topic = (faulty.name, "") if isinstance(faulty, LinkSnapshot) else (faulty.link, _name(faulty))
        code = EventCode.OPERATOR_ACKNOWLEDGEMENT_ENDED
        self._events.add(Level.INFO, code, f"{topic}: {text}" if topic else text, link=link, topic=topic)

    def _record(self, faulty: AnyFaulty) -> Acknowledgement | None:
        known = self._known.get(_key(faulty))
        return None if known is None else known.record

    def _marked_link(self, link: LinkSnapshot, before: dict[Any, Any]) -> LinkSnapshot:
        record, records = self._record(link), [self._record(row) for row in link.patterns]
        if record is None and not any(records):
            return link
        pairs = zip(link.patterns, records, strict=True)
        rows = (row if each is None else dataclasses.replace(row, acknowledged=each) for row, each in pairs)
        return self._copy(link, before, record, patterns=tuple(rows))

    def _copy(self, faulty: Faulty, before: dict[Any, Any], record: Acknowledgement | None, **others: Any) -> Faulty:
        """Return a marked copy; the one of `before` if nothing has changed."""
        old, new = before.get(_key(faulty), (None, None))
        # Attached consoles are sent what is another object than before (`control.states`).
        if old is not faulty or new.acknowledged != record:
            new = dataclasses.replace(faulty, acknowledged=record, **others)
        self._marked[_key(faulty)] = faulty, new
        copy: Faulty = new
        return copy


def _is_fault(faulty: AnyFaulty, state: State, cause: str) -> bool:
    causes = {cause, faulty.cause}
    return state is faulty.state and (len(causes) == 1 or causes <= _ONE_FAULT)


def has_fault(faulty: AnyFaulty) -> bool:
    """Whether it has a fault, or waits, so that it can be acknowledged."""
    return faulty.state not in _NO_FAULT or (isinstance(faulty, LinkSnapshot) and bool(faulty.warning))


def find_faulty(snapshot: Snapshot, key: str, link: str, seen: tuple[State, str] | None = None) -> AnyFaulty:
    """Return the link, route or pattern that an operator names.

    Args:
        key: of a route or a pattern. A route that suffers from its link's fault has the link's fault.
        link: the name of a link, or an empty string.
        seen: the state and the cause with which the operator has seen it, or None.

    Raises:
        ValueError: it does not exist, or has another state or cause by now.
    """

    def as_seen(faulty: Faulty) -> Faulty:
        if seen is not None and not _is_fault(faulty, *seen):
            raise ValueError(f"{_name(faulty)} is {faulty.state.upper()} by now: look again")
        return faulty

    links = {each.name: each for each in snapshot.links}
    if link:
        if link not in links:
            raise ValueError(f"no link {link!r}; links: {', '.join(links) or 'none'}")
        return as_seen(links[link])
    for route in snapshot.routes:
        if route.key == key:
            link_of = links.get(as_seen(route).link)
            return link_of if link_of is not None and explained_by_link(route.cause, link_of) else route
    for pattern in (pattern for each in snapshot.links for pattern in each.patterns):
        if pattern.key == key:
            return pattern
    raise ValueError(f"the route {key!r} was removed")


def _key(faulty: AnyFaulty) -> tuple[str, str]:
    return ("link", faulty.name) if isinstance(faulty, LinkSnapshot) else ("route", faulty.key)


def _name(faulty: AnyFaulty) -> str:
    if isinstance(faulty, LinkSnapshot):
        return faulty.name
    return faulty.topic if isinstance(faulty, RouteSnapshot) else faulty.spec.topic
