"""States of units, and how an action on one has ended: their types have bounds, for links and for consoles."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import PRINTABLE, TEXT_LENGTH, OrderOutcome, Seconds, Wording

MOST_UNITS = 32
"""Of a session. A round figure: an operator finds one in a list of so many, and each has a status to be asked for."""
NAME = re.compile(r"[A-Za-z0-9_-]{1,63}")
LINES = 64
"""The most lines of an output that cross: a screenful."""

UnitName: TypeAlias = Annotated[str, Meta(max_length=63, pattern=r"\A[A-Za-z0-9_-]*\Z")]
UnitAction: TypeAlias = Literal["start", "stop", "restart"]
Lines: TypeAlias = Annotated[
    tuple[Annotated[str, Meta(max_length=TEXT_LENGTH, pattern=PRINTABLE)], ...], Meta(max_length=LINES)
]
ACTIONS: tuple[UnitAction, ...] = ("start", "stop", "restart")


class UnitState(StrEnum):
    RUNNING, STOPPED, FAILED, UNKNOWN = "running", "stopped", "failed", "unknown"


class UnitRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """A unit, as the other side and operators see it.

    Attributes:
        actions: those that it has.
        allowed: whether the one who asks may ask for them.
        age: s since the state was found, or None if nobody has found one yet.
        doing: the action that is under way, or None.
    """

    name: UnitName
    actions: Annotated[tuple[UnitAction, ...], Meta(max_length=len(ACTIONS))] = ()
    allowed: bool = False
    state: UnitState = UnitState.UNKNOWN
    age: Seconds | None = None
    doing: UnitAction | None = None


UnitRecords: TypeAlias = Annotated[tuple[UnitRecord, ...], Meta(max_length=MOST_UNITS)]


class UnitOutcome(OrderOutcome, frozen=True):
    """How an action has ended. It is done once the unit is in its new state, or the state is given up.

    Attributes:
        state: the last one found.
        output: the end of what the command has printed.
        log: the end of the unit's log, if it is not done.
    """

    state: UnitState = UnitState.UNKNOWN
    output: Lines = ()
    log: Lines = ()


class UnitText(Wording):
    """How an action has ended, in words."""

    START = "it runs, after {seconds:.1f} s"
    STOP = "it stopped in {seconds:.1f} s"
    RESTART = "it came back in {seconds:.1f} s"
    STATELESS = "{action} done in {seconds:.1f} s; without status, nobody knows whether it runs"

    @classmethod
    def of(cls, action: UnitAction, outcome: UnitOutcome) -> str:
        """Return the end of an action: what is wrong first, if anything is."""
        if not outcome.done:
            return outcome.reason
        text = cls.STATELESS if outcome.state is UnitState.UNKNOWN else cls[action.upper()]
        return text(action=action, seconds=outcome.seconds)
