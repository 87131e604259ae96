"""What a console asks an engine about units: which there are, and an action on one."""

from __future__ import annotations

import msgspec

from rsb_bridge.feature_api import TICKET_WITHIN, Command, Effect, Name, Reason, Right
from rsb_extras.units.unit_records import UnitAction, UnitOutcome, UnitRecords

LONGEST = 180.0
"""s until the other side has answered for sure: the longest action with its log, and the way over a slow link."""
ANSWERED_WITHIN = TICKET_WITHIN + LONGEST + 5.0
"""s until an engine has answered a `ControlUnit` for sure."""


class UnitGroup(msgspec.Struct, frozen=True, omit_defaults=True):
    """The units of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: why nothing is known of them, or empty.
    """

    link: Name = ""
    units: UnitRecords = ()
    problem: Reason = ""


class ListUnits(Command[tuple[UnitGroup, ...]], frozen=True, tag="list_units"):
    """List the units of this side and of all links, or of one link; sides without units are left out."""

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    cancellable = True
    link: str = ""


class ControlUnit(Command[UnitOutcome], frozen=True, tag="control_unit"):
    """Start, stop or restart a unit, and wait until it is in its new state."""

    always = Effect.MOVES | Effect.LOSES
    refreshes = False
    unit: str
    action: UnitAction
    link: str = ""  # whose other side has it, or empty for this side
