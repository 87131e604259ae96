"""The arguments of the command ``units``, and the keys of its screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, KeyChapter, bridge_options, side_options, subcommand
from rsb_extras.units.unit_records import ACTIONS

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
Units are listed in the session file of the machine that has them; their commands
stay there. The other side's session says which ones it lets this side ask for
(may). An action asks first, and ends once the unit is in its new state.

for example:
  rsb-console units
  rsb-console units restart nav
  rsb-console units restart lidar --link robot2 --yes

exit codes:
  0  listed, or done
  1  refused or failed; then the end of the unit's log is printed
{NO_BRIDGE}"""
CHAPTER = KeyChapter(
    "Units", "UnitsScreen",
    (("x", "restart the unit, after a question"), ("s S", "start it, stop it"), ("esc", "close")),
)  # fmt: skip


def add_units(add: AddCommand, complete: Complete) -> None:
    summary = "list units of both sides; start, stop or restart one"
    units = add("units", subcommand("rsb_extras.units.units_command:units"), summary, _MORE, after="call")
    bridge_options(units, complete)
    units.add_argument("action", nargs="?", choices=ACTIONS, help="the action; without it, all units are listed")
    unit = units.add_argument("unit", nargs="?", metavar="UNIT", help="the unit's name")
    complete(unit, "rsb_extras.units.unit_names:unit_names")
    side_options(units, complete, "units", "a unit of that name")
    units.add_argument("--yes", action="store_true", help="do not ask")
    units.set_defaults(in_fleet=True)
