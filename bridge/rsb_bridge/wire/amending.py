"""The control messages that change an open route (PROTOCOL.md, 3)."""

from __future__ import annotations

from msgspec import UNSET, UnsetType

from rsb_bridge.wire.fields import (
    Count,
    Hertz,
    LateAfter,
    MaxAge,
    Name,
    Rank,
    RouteId,
    StaleAfter,
    check_limits,
)
from rsb_bridge.wire.message import ControlMessageBase


class Amend(ControlMessageBase, frozen=True):
    """The route goes on with other limits; the fields are those of `Propose`.

    The route's proposer decides: it tells what holds from now on. The other side asks it by the same message, and
    changes nothing before the proposer has answered. `who` is the operator who changes it; empty in an answer. An older
    side sends no `priority`, `late_after` or `max_age`; then the route keeps its own.
    """

    route: RouteId
    max_rate: Hertz = 0.0
    expected_rate: Hertz = 0.0
    stale_after: StaleAfter | None = None
    who: Name = ""
    priority: Rank | None = None
    late_after: LateAfter | UnsetType | None = UNSET
    max_age: MaxAge | UnsetType | None = UNSET

    def __post_init__(self) -> None:
        check_limits(self.max_rate, self.expected_rate, self.stale_after, self.late_after, self.max_age)


class Limit(ControlMessageBase, frozen=True):
    """Either side: it lets no more of the route's messages cross, whatever the proposer has asked for.

    Attributes:
        route: route id.
        max_rate: Hz; 0: all.
    """

    route: RouteId
    max_rate: Hertz = 0.0

    def __post_init__(self) -> None:
        check_limits(self.max_rate)


class Pause(ControlMessageBase, frozen=True):
    """Either side: the route pauses or resumes.

    Attributes:
        route: route id.
        paused: it pauses; else it resumes.
        revision: of the change that led to this state: above all that the side that made it had seen. The higher one
            counts on both sides, and of two equal ones the client's.
        who: the operator who made it, in words; empty: not known any more.
    """

    route: RouteId
    paused: bool
    revision: Count
    who: Name = ""
