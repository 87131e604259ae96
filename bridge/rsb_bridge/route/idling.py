"""Decides when a route is ticked: once a second while anything happens, and otherwise when something is due.

The effects of a message, a report, a command or a change of the graph follow within seconds, and nearly all windows
over which a route is judged are as short. So a route is ticked for a while after each event, for less if these windows
are empty, and from then on only at the time that its rules name: `next_change`. Each event calls `Route.wake`, messages
too. One whose messages go on as before is ticked each fifth second, and each second in between its counts alone tell
whether they do. Nothing walks over idle routes: to touch hundreds of objects once a second takes longer than the work
on a few.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import count
from math import inf
from typing import TYPE_CHECKING, Generic, Protocol, TypeAlias, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

SETTLES = 12.0
"""s after an event for which a route is ticked: longer than `watches.LATELY`, `topic_flow._LATENCY_LASTS` and
`combined_verdict._WAITS`. Longer windows of the rules are in `next_change`."""
_CALMS = 0.9
"""s after an event for which a route is ticked that is calm: all that follows from it at once has followed. Less than a
second, as the tick that follows another one may come a little early."""
STEADY_FOR = 4.5
"""s after a tick until the next one of a route whose messages go on as before, while nobody looks on either side: its
figures are then as old as those for the record (`snapshot_publisher._FIGURES_EVERY`). Ticks may come a little early."""
POLLED_EVERY = 15.0  # s, at most, between two ticks of a route with something that does not tell when it changes
_MOST_OUTDATED = 4096  # times of routes that were woken meanwhile, about, until they are looked through

Signs: TypeAlias = tuple[object, ...]
"""What a route's verdict and its figures follow from, messages aside; they are equal while nothing happens."""


class GoesOn(Protocol):
    """A half that knows whether messages go on as before."""

    def goes_on(self, now: float) -> bool:
        """Whether they have done so since the last tick, until `now` (s)."""


class Idling:
    """Decides when a route is ticked next.

    Attributes:
        until: time (s) of the next tick.
        steady_until: time (s) of the next tick if its messages go on as before until then.
        goes_on_now: whether it is not ticked in the present second, as they do.
        passed: messages at the last tick.
        signs: of the last tick, the same object as long as they are equal.
    """

    __slots__ = ("_changed_at", "_settles_until", "goes_on_now", "passed", "signs", "steady_until", "until")

    def __init__(self, now: float) -> None:
        self.until = now
        self.steady_until = -inf
        self.goes_on_now = False
        self._settles_until = now + SETTLES
        self.signs: Signs = ()
        self._changed_at = now
        self.passed = 0

    def wake(self, now: float) -> None:
        """Have the route ticked each second again, as something has happened to it."""
        self.until, self._settles_until, self.steady_until, self.goes_on_now = now, now + SETTLES, -inf, False

    def is_steady(self, now: float) -> bool:
        """Whether counts alone tell if its messages go on as before."""
        return now < self.steady_until

    def goes_on(self, now: float, meter: GoesOn, half: GoesOn) -> bool:
        """Whether the route needs no tick at `now` (s), as its messages go on as before. Asked once a second."""
        self.goes_on_now = now < self.steady_until and meter.goes_on(now) and half.goes_on(now)
        return self.goes_on_now

    def missed(self, signs: Callable[[], Signs], now: float) -> bool:
        """Whether the signs have changed of a route that is not ticked now, or about not to be."""
        return (now < self.until or now < self.steady_until) and signs() != self.signs

    def lasts(self, signs: Callable[[], Signs], now: float) -> bool:
        """Whether the signs have been the same for so long that all has followed from them."""
        return now >= self._changed_at + SETTLES and signs() == self.signs

    def ticked(
        self,
        signs: Signs,
        passed: int,
        now: float,
        next_change: Callable[[], float],
        is_calm: Callable[[float], bool],
    ) -> None:
        """Decide after a tick when the next one is.

        Args:
            passed: messages so far.
            next_change: returns the time (s) of the next change by time alone, `now` if it may come at any moment, or
                infinity.
            is_calm: tells whether the windows over which the route is judged are empty.
        """
        if signs != self.signs:
            self.signs, self._changed_at = signs, now
            self._settles_until = now + SETTLES
        elif passed != self.passed:
            self._settles_until = now + SETTLES
        self.passed, self.goes_on_now = passed, False
        left = self._settles_until - now
        settles = left > 0.0 and (left > SETTLES - _CALMS or not is_calm(now))
        self.until = now if settles else next_change()


class Tickable(Protocol):
    """The members of a route that its ticks use."""

    idle: bool
    idling: Idling

    @property
    def meter(self) -> GoesOn: ...

    @property
    def half(self) -> GoesOn: ...

    def tick(self) -> None:
        """Do what is done once a second."""

    def rests(self, now: float) -> bool:
        """Whether it needs no tick at `now` (s)."""

    def rise(self) -> None:
        """Be awake again."""


TickableT = TypeVar("TickableT", bound=Tickable)


def tick_if_due(route: Tickable, now: float, *, looked_at: bool) -> None:
    """Tick a route at `now` (s), unless its messages go on as before and nobody looks."""
    if looked_at or not route.idling.goes_on(now, route.meter, route.half):
        route.tick()


class Timetable(Generic[TickableT]):
    """The routes of one link that are to be ticked.

    Attributes:
        awake: the routes that are ticked.
        changes: how many have come or gone.
        looked: time (s) of the last look.
    """

    def __init__(self, now: float) -> None:
        self.awake: dict[TickableT, None] = {}
        self.changes = 0
        self.looked = now
        self._times: list[tuple[float, int, TickableT]] = []  # a heap of the times of idle ones, and of some that were
        self._number = count()

    def add(self, route: TickableT) -> None:
        """Begin with a route, which is awake."""
        self.awake[route] = None
        self.changes += 1

    def look(self, now: float) -> list[TickableT]:
        """Return the routes that are not idle at `now` (s). Called once a second."""
        times = self._times
        while times and times[0][0] <= now:
            until, _, route = heappop(times)
            if route.idle and route.idling.until == until:  # else it was woken, or has gone
                route.rise()
        for route in [each for each in self.awake if now < each.idling.until and each.rests(now)]:
            del self.awake[route]
            route.idle = True
            if route.idling.until < inf:
                heappush(times, (route.idling.until, next(self._number), route))
        if len(times) > _MOST_OUTDATED:
            self._times = [each for each in times if each[2].idle and each[2].idling.until == each[0]]
            heapify(self._times)
        self.looked = now
        return [*self.awake]

    def remove(self, route: TickableT) -> None:
        """Forget a route that has gone."""
        self.awake.pop(route, None)
        self.changes += 1
        route.idling.until = -inf
