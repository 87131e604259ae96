"""The drivers of a robot: the nodes, links and hands that publish a topic by which it moves."""

from __future__ import annotations

from collections import defaultdict, deque
from math import isfinite
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.limits import RATE
from rsb_bridge.model.snapshot import Driver
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.announcements import BY_HAND
from rsb_bridge.route.combined_verdict import NODE_LENGTH
from rsb_bridge.wire.records import DriverRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
    from rsb_bridge.route.half import Carried
    from rsb_bridge.route.route import Route

_MOST = 8
"""Drivers that a side names. A round figure."""
_TICKS = 3
"""Ticks, of about 1 s each, over which a driver's rate is taken: a driver that stops is shown no longer than that."""


class Drivers:
    """The drivers of one route's topic on both sides, as one half knows them; none if it moves no robot.

    Attributes:
        here: on this side, by name.
        there: on the other side, as that reports them.
    """

    def __init__(self, route: Route, carried: Carried[Any]) -> None:
        self._route, self._carried = route, carried
        self.here: tuple[Driver, ...] = ()
        self.there: tuple[Driver, ...] = ()
        self._counts: defaultdict[bytes, int] = defaultdict(int)  # messages since the last tick, by publisher
        # Those before, and how long (s) each took.
        self._ticks: deque[tuple[defaultdict[bytes, int], float]] = deque(maxlen=_TICKS)
        self._ticked = route.context.now()

    @property
    def are_watched(self) -> bool:
        """Whether the topic may move a robot, or has to be armed, as somebody thinks so."""
        return self._carried.may_move or self._route.arming.required

    @property
    def all(self) -> tuple[Driver, ...]:
        return self.here + self.there

    @property
    def several(self) -> tuple[Driver, ...]:
        """The drivers if they are several, one of which at least publishes what this route carries, or none."""
        sending = self.here if self._route.outgoing else self.there
        return self.all if sending and len(self.all) > 1 else ()

    def look(self, endpoints: Iterable[Endpoint], *, counted: bool = False) -> None:
        """Find the drivers on this side among the publishers there, without this link's own.

        Args:
            counted: whether the route takes their messages now.
        """
        if not self.are_watched:
            self.here = ()
            return
        found: dict[tuple[bool, str], float] = {}
        for each in endpoints:
            if self._carried.type_name not in ("", each.type_name):
                continue  # whoever hears this topic does not hear it
            own = self._route.context.announcements.own_of(each.gid)
            if own is None:
                who = False, sanitize_text(each.node, NODE_LENGTH)
            elif own.link == BY_HAND:
                who = True, ""
            elif own.origin.via and own.origin.live and own.crosses():
                who = False, f"link {own.link}"
            else:
                continue  # nothing comes over that link now, or it is there for the end of an arming
            found[who] = found.get(who, 0.0) + self._rate(each.gid)
        self.here = tuple(
            [
                Driver(name, here=True, rate=rate if counted else None, by_hand=by_hand)
                for (by_hand, name), rate in sorted(found.items())[:_MOST]
            ]
        )

    def told(self, records: Iterable[DriverRecord]) -> None:
        """Take the other side's drivers."""
        self.there = tuple([Driver(each.name, False, _plausible(each.rate), each.by_hand) for each in records])

    @property
    def records(self) -> tuple[DriverRecord, ...]:
        """The drivers here, for the other side."""
        return tuple([DriverRecord(each.name, each.rate, each.by_hand) for each in self.here])

    def count(self, batch: Sequence[RawMessage]) -> None:
        """Count messages that the route takes."""
        for each in batch:
            self._counts[each.gid] += 1

    def tick(self, now: float) -> None:
        """End a tick at `now` (s). Called once a second unless the route is idle."""
        if (elapsed := now - self._ticked) <= 0.0:
            return
        self._ticks.append((self._counts, elapsed))
        self._counts, self._ticked = defaultdict(int), now

    @property
    def are_calm(self) -> bool:
        """Whether none has published in the last seconds."""
        return not (self._counts or any(counts for counts, _ in self._ticks))

    def rested(self, until: float) -> None:
        """Take over that nothing came until `until` (s)."""
        self._ticks.clear()
        self._ticked = until

    def _rate(self, gid: bytes) -> float:
        took = sum([elapsed for _, elapsed in self._ticks])
        # Rounded, as each report to the other side that differs is sent.
        return round(sum([counts.get(gid, 0) for counts, _ in self._ticks]) / took, 1) if took else 0.0


def _plausible(rate: float | None) -> float | None:
    """Return a rate that a peer reports, or None if it is impossible."""
    return rate if rate is not None and isfinite(rate) and 0.0 <= rate <= RATE.high else None
