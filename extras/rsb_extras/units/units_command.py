"""The command ``units``: lists units, and has one started, stopped or restarted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import asdict

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import (
    FAILURE,
    OK,
    SideText,
    UsageError,
    agreed,
    attached,
    chosen_side,
    done,
    json_line,
    print_error,
    print_line,
    print_problems,
    problems_of,
    result,
    side_of,
    table_lines,
)
from rsb_console.notation import formats
from rsb_extras.units.unit_records import UnitText
from rsb_extras.units.unit_requests import ANSWERED_WITHIN, ControlUnit, ListUnits

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence

    from rsb_bridge.feature_api import RemoteEngine
    from rsb_extras.units.unit_records import UnitOutcome, UnitRecord
    from rsb_extras.units.unit_requests import UnitGroup

_NOTHING = "-"
HEADINGS = "UNIT", "SIDE", "STATE", "AGE", "ACTIONS"


class UnitsCommandText(Wording):
    NAME_MISSING = "units {action}: name the unit"
    UNKNOWN = "there is no unit {name}{problems}; there are: {known}"
    SEVERAL = "{count} sides have a unit {name}; choose one: {options}"
    NONE = "neither side lists units in its session file"
    ASK = "{action} unit {name} of {side}?"
    ENDED = "unit {name} of {side}: {text}"


def state_text(unit: UnitRecord) -> str:
    return f"{unit.doing} under way" if unit.doing else unit.state


def age_text(unit: UnitRecord) -> str:
    return _NOTHING if unit.age is None else formats.age(unit.age)


def actions_text(unit: UnitRecord) -> str:
    """Return the actions that may be asked for, in words."""
    if not unit.actions:
        return _NOTHING
    return " ".join(unit.actions) if unit.allowed else SideText.NO_RIGHT()


def units(arguments: Namespace) -> int:
    if arguments.action and arguments.unit is None:
        raise UsageError(UnitsCommandText.NAME_MISSING(action=arguments.action))
    with attached(arguments) as engine:
        groups = result(engine.do(ListUnits(arguments.link)))
        if not arguments.action:
            return _list(engine, arguments, groups)
        return _control(engine, arguments, _chosen(arguments, groups))


def _list(engine: RemoteEngine, arguments: Namespace, groups: Sequence[UnitGroup]) -> int:
    role = engine.bridge.role
    problems = problems_of(groups, arguments.link)
    if arguments.json:
        listed = [{"link": group.link} | asdict(unit) for group in groups for unit in group.units]
        return done(arguments, units=listed, problems=problems)
    for line in _lines(role, groups):
        print_line(line)
    print_problems(role, problems)
    return OK


def _lines(role: str, groups: Sequence[UnitGroup]) -> Iterator[str]:
    rows = [
        (unit.name, side_of(role, group.link), state_text(unit), age_text(unit), actions_text(unit))
        for group in groups
        for unit in group.units
    ]
    return table_lines(HEADINGS, rows) if rows else iter([UnitsCommandText.NONE()])


def _chosen(arguments: Namespace, groups: Sequence[UnitGroup]) -> str:
    """Return the link whose other side has the unit, or an empty string for this side."""
    sides = [group for group in groups if not (arguments.here and group.link)]
    names = [(group.link, unit.name) for group in sides for unit in group.units]
    texts = UnitsCommandText
    return chosen_side(arguments.unit, names, sides, several=texts.SEVERAL, unknown=texts.UNKNOWN)


def _control(engine: RemoteEngine, arguments: Namespace, link: str) -> int:
    name, action, side = arguments.unit, arguments.action, side_of(engine.bridge.role, link)
    question = UnitsCommandText.ASK(action=action.capitalize(), name=name, side=side)
    if not (arguments.yes or agreed(question, ask=not arguments.json)):
        return FAILURE
    outcome = engine.do(ControlUnit(name, action, link)).result(ANSWERED_WITHIN)
    if arguments.json:
        found = asdict(outcome) | {"unit": name, "link": link}
        error = found.pop("reason")
        print_line(json_line({"ok": outcome.done} | ({"error": error} if error else {}) | found))
    else:
        _tell(UnitsCommandText.ENDED(name=name, side=side, text=UnitText.of(action, outcome)), outcome)
    return OK if outcome.done else FAILURE


def _tell(text: str, outcome: UnitOutcome) -> None:
    if outcome.done:
        print_line(text)
        return
    for line in (*outcome.output, *outcome.log):
        print_line(line)
    print_error(text)
