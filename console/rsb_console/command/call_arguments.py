"""The arguments of the commands that call by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.argument_values import seconds
from rsb_console.command.remote_arguments import (
    KINDS,
    NO_BRIDGE,
    bridge_options,
    inherit_bridge_options,
    route_arguments,
    route_command,
    subcommand,
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
_PARAM = f"""\
The parameters of the node have to be bridged: rsb-console add --parameters. For
others there is rsb-console params.

exit codes:
  0  done
  1  the node or the bridge refused or did not answer; the message has the reason
{NO_BRIDGE}"""


def add_call_commands(command: AddCommand, complete: Complete) -> None:
    """Add `call`, and `param` with its own commands."""
    summary = "call a bridged service once, and print its response as YAML"
    call = route_command(command, complete, "call", "call_command:call_service", summary, _CALL, kinds=KINDS[1:])
    fields = "the request's fields; -: read them from standard input"
    call.add_argument("request", metavar="YAML", nargs="?", default="", help=fields)
    lanes = "for an action: send_goal, cancel_goal, get_result; for parameters: set_parameters, ..."
    complete(call.add_argument("--lane", default="", metavar="SERVICE", help=lanes), "lanes")
    limit = "give up after this time; default: the route's timeout; for get_result, until the goal is over"
    call.add_argument("--timeout", type=seconds, metavar="SECONDS", help=limit)
    summary = "read and set the parameters of a bridged node"
    parent = command("param", subcommand("call_command:list_parameters"), summary, _PARAM)
    bridge_options(parent, complete)
    commands = parent.add_subparsers(metavar="COMMAND", required=True)
    words: tuple[str, ...]
    for name, function, summary, words in (
        ("list", "list_parameters", "print the names of a node's parameters", ()),
        ("get", "get_parameter", "print the value of a parameter", ("parameter",)),
        ("set", "set_parameter", "set a parameter", ("parameter", "value")),
        ("dump", "dump_parameters", "print all parameters of a node as YAML, as ros2 param dump does", ()),
        ("describe", "describe_parameter", "print a parameter's type, range and description", ("parameter",)),
    ):
        parser = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        parser.set_defaults(command=subcommand(f"call_command:{function}"))
        bridge_options(parser, complete)
        inherit_bridge_options(parser)
        route_arguments(parser, complete, kinds=("parameters",), metavar="NODE")
        for word in words:
            argument = parser.add_argument(word, metavar=word.upper())
            if word == "parameter":
                complete(argument, "parameters")
        if name == "set":
            kinds = "type of the value: bool, integer, double, string, byte_array, ...; default: as the value looks"
            complete(parser.add_argument("--type", default="", metavar="TYPE", help=kinds), "parameter_types")
