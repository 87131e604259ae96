"""The keys that change what is shown."""

from __future__ import annotations

from rsb_console.actions.action import Action, Group, late

# Each list has its own way to move, as a method `action_<id>`.
MOVES = (
    Action("move_down", "j,down", "down", "Next line", Group.MOVE),
    Action("move_up", "k,up", "up", "Previous line", Group.MOVE),
    Action("move_first", "g,home", "first", "First line", Group.MOVE),
    Action("move_last", "G,end", "last", "Last line", Group.MOVE),
    Action("page_down", "pagedown", "page down", "One page down", Group.MOVE),
    Action("page_up", "pageup", "page up", "One page up", Group.MOVE),
)
_PLACE = "rsb_console.operations.view_operations"
ACTIONS = (
    Action("detail", "enter", "detail", "Open the details, then a topic's message; or the full log line", Group.VIEW,
           in_footer=True, run=late(f"{_PLACE}:detail"), possible=late(f"{_PLACE}:has_detail"),
           footer=late(f"{_PLACE}:detail_in_footer")),
    Action("message", "v", "message", "View a topic's messages, as a picture or as text", Group.VIEW,
           needs_topic=True, run=late(f"{_PLACE}:message")),
    Action("back", "escape", "back", "Close what is open, or drop the filter", Group.VIEW, run=late(f"{_PLACE}:back")),
    Action("filter", "slash", "filter", "Filter: terms, !terms; state: kind: robot: type: via: why:", Group.VIEW,
           in_footer=True, run=late(f"{_PLACE}:filter_lines")),
    Action("next_match", "n", "next", "Next match; without a filter, next fault", Group.VIEW,
           run=late(f"{_PLACE}:next_match")),
    Action("previous_match", "N", "previous", "Previous match; without a filter, previous fault", Group.VIEW,
           run=late(f"{_PLACE}:previous_match")),
    Action("faults", "f", "faults", "Show faults only", Group.VIEW, in_footer=True, run=late(f"{_PLACE}:faults"),
           footer=late(f"{_PLACE}:faults_in_footer")),
    Action("sort_left", "less_than_sign", "sort", "Sort by the column to the left", Group.VIEW,
           run=late(f"{_PLACE}:sort_left")),
    Action("sort_right", "greater_than_sign", "sort", "Sort by the column to the right", Group.VIEW,
           run=late(f"{_PLACE}:sort_right")),
    Action("reverse", "s", "reverse", "Reverse the order", Group.VIEW, run=late(f"{_PLACE}:reverse")),
    Action("group", "B", "group", "Group the topics by robot", Group.VIEW, run=late(f"{_PLACE}:group")),
    Action("columns", "vertical_line", "columns", "Choose the columns of the topics", Group.VIEW,
           run=late("rsb_console.screens.columns_screen:show_columns"), also="hide, show"),
    Action("freeze", "space", "freeze", "Freeze the view; the bridge goes on", Group.VIEW,
           run=late(f"{_PLACE}:freeze")),
    Action("zoom", "z", "zoom", "Give the focused pane the whole screen", Group.VIEW, run=late(f"{_PLACE}:zoom")),
    Action("log", "l", "log", "Go to the log, and back", Group.VIEW, in_footer=True, run=late(f"{_PLACE}:log")),
    Action("level", "L", "level", "Log level: all, info, WARN, ERROR", Group.VIEW, run=late(f"{_PLACE}:level")),
    Action("copy", "y", "copy", "Copy the line under the cursor, over SSH too", Group.VIEW,
           run=late(f"{_PLACE}:copy_line")),
    Action("export", "x", "export", "Write the focused pane's lines to a file", Group.VIEW,
           run=late(f"{_PLACE}:export")),
)  # fmt: skip
