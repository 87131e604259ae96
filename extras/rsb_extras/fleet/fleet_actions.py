"""The registry of keys and actions of the fleet's screen."""

from __future__ import annotations

from dataclasses import replace

from rsb_console.feature_console import ACTIONS, Action, Group

_ON_FLEET = {
    "back": "Drop the filter, the marks",
    "filter": "Filter: terms, !terms; state: robot: group: why:",
    "next_match": "Next match; without a filter, next fault",
    "previous_match": "Previous match; without a filter, previous fault",
    "faults": "Show only robots with something wrong",
    "sort_left": "Sort by the column to the left",
    "sort_right": "Sort by the column to the right",
    "reverse": "Reverse the order",
    "group": "Group the robots",
    "copy": "Copy the line under the cursor, over SSH too",
    "quit": "Quit; the bridges go on",
}
"""What actions of the console do on the fleet's screen."""

# As `ACTIONS`, of the fleet's screen. An action that both have has one id, and so one key.
FLEET_ACTIONS: tuple[Action, ...] = (
    Action("open_robot", "enter", "open", "Open the console on the robot; of a group, fold or unfold it",
           Group.FLEET, in_footer=True),
    Action("mark", "space", "mark", "Mark the robot, or all of the group", Group.FLEET, in_footer=True),
    Action("edit_marked", "e", "edit", "Edit a topic of the marked robots, one after the other",
           Group.FLEET, changes=True, in_footer=True, also="roll out, max_rate, pause"),
    Action("dismiss", "d", "dismiss", "Forget the robots that have gone", Group.FLEET, in_footer=True),
    *(replace(action, help=_ON_FLEET.get(action.id, action.help), run=None) for action in ACTIONS
      # The fleet's app has no bell.
      if action.id in _ON_FLEET or (action.group in (Group.MOVE, Group.CONSOLE) and action.id != "bell_on_fault")),
)  # fmt: skip
BY_ID = {action.id: action for action in FLEET_ACTIONS}
