"""The arguments of the command that calls by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.argument_values import seconds
from rsb_console.command.remote_arguments import (
    KINDS,
    NO_BRIDGE,
    route_command,
)

if TYPE_CHECKING:
    from rsb_console.command.remote_arguments import AddCommand, Complete

_CALL = f"""\
The bridge calls it: in this side's domain if the node is there, else over the
link. The type has to be installed where this bridge runs.

for example:
  rsb-console call /dock
  rsb-console call /map_server/load_map '{{map_url: /maps/hall.yaml}}'

to send a goal, wait for its result, or cancel it:
  rsb-console call /navigate_to_pose --lane send_goal '{{goal: {{...}}}}'  # prints its goal_id
  rsb-console call /navigate_to_pose --lane get_result '{{goal_id: ID}}'
  rsb-console call /navigate_to_pose --lane cancel_goal '{{goal_info: {{goal_id: ID}}}}'

exit codes:
  0  the response is printed
  1  no response came, or the bridge refused; the message has the reason
{NO_BRIDGE}"""


def add_call_command(command: AddCommand, complete: Complete) -> None:
    """Add `call`."""
    summary = "call a bridged service once, and print its response as YAML"
    call = route_command(command, complete, "call", "call_command:call_service", summary, _CALL, kinds=KINDS[1:])
    fields = "the request's fields; -: read them from standard input"
    call.add_argument("request", metavar="YAML", nargs="?", default="", help=fields)
    lanes = "for an action: send_goal, cancel_goal, get_result; for parameters: set_parameters, ..."
    complete(call.add_argument("--lane", default="", metavar="SERVICE", help=lanes), "lanes")
    limit = "give up after this time; default: the route's timeout; for get_result, until the goal is over"
    call.add_argument("--timeout", type=seconds, metavar="SECONDS", help=limit)
