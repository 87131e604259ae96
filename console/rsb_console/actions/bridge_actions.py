"""The keys for the whole bridge and its links."""

from __future__ import annotations

from rsb_console.actions.action import Action, Group, late

_PLACE = "rsb_console.operations.bridge_operations"
ACTIONS = (
    Action("retry", "r", "retry", "Try to connect again now", Group.OPERATE, changes=True, run=late(f"{_PLACE}:retry")),
    Action("restart", "R", "restart", "Close all links on both sides and open them again", Group.OPERATE,
           changes=True, in_footer=True, run=late(f"{_PLACE}:restart")),
    Action("reload", "f6", "reload", "Read the session file again, and change what differs", Group.OPERATE,
           changes=True, run=late(f"{_PLACE}:reload")),
    Action("links", "c", "links", "Show the links; a server has one per robot", Group.SESSION, in_footer=True,
           run=late("rsb_console.screens.links_screen:show_links"), footer=late(f"{_PLACE}:links_in_footer")),
)  # fmt: skip
