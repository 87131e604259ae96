"""The arguments of the commands that call services by hand, and set parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.command.remote_arguments import KINDS, NO_BRIDGE, bridge_options, lazily, route_arguments
from rsb_console.command.values import seconds

if TYPE_CHECKING:
    from rsb_console.command.remote_arguments import AddCommand, Complete

_CALL = f"""\
The bridge calls it: in this side's domain if the node is there, else over the
link. The type has to be installed where this bridge runs.

for example:
  rsb-console call /dock
  rsb-console call /map_server/load_map '{{map_url: /maps/hall.yaml}}'

a goal is sent, its result waited for, and it may be cancelled meanwhile:
  rsb-console call /navigate_to_pose --lane send_goal '{{goal: {{...}}}}'  # prints its goal_id
  rsb-console call /navigate_to_pose --lane get_result '{{goal_id: ID}}'
  rsb-console call /navigate_to_pose --lane cancel_goal '{{goal_info: {{goal_id: ID}}}}'

exit codes:
  0  there is an answer, and it is printed
  1  there is none, or the bridge refused: why is said
{NO_BRIDGE}"""
_PARAM = f"""\
The parameters of the node have to be bridged: rsb-console add --parameters.

exit codes:
  0  done
  1  the node or the bridge refused, or did not answer: why is said
{NO_BRIDGE}"""


def add_call_commands(command: AddCommand, complete: Complete) -> None:
    """Add `call`, and `param` with its own commands; the arguments are those of `add_remote_commands`."""
    call = command(
        "call", lazily("call", "calling"), "call a bridged service once, and print its response as YAML", _CALL
    )
    bridge_options(call, complete)
    route_arguments(call, complete, kinds=KINDS[1:])
    call.add_argument(
        "request", metavar="YAML", nargs="?", default="", help="the request's fields; -: read them from standard input"
    )
    lanes = "of an action: send_goal, cancel_goal, get_result; of parameters: set_parameters, ..."
    complete(call.add_argument("--lane", default="", metavar="SERVICE", help=lanes), "lanes")
    limit = "give up after so long; else after the route's timeout, and get_result waits until the goal is over"
    call.add_argument("--timeout", type=seconds, metavar="SECONDS", help=limit)
    parent = command("param", lazily("list", "parameters"), "read and set the parameters of a bridged node", _PARAM)
    commands = parent.add_subparsers(metavar="COMMAND", required=True)
    words: tuple[str, ...]
    for name, summary, words in (
        ("list", "print the names of a node's parameters", ()),
        ("get", "print the value of a parameter", ("parameter",)),
        ("set", "set a parameter", ("parameter", "value")),
        ("dump", "print all parameters of a node as YAML, as ros2 param dump does", ()),
        ("describe", "print the type of a parameter, its range, and what the node says of it", ("parameter",)),
    ):
        parser = commands.add_parser(name, help=summary, description=f"{summary}.")
        parser.set_defaults(command=lazily(name, "parameters"))
        bridge_options(parser, complete)
        route_arguments(parser, complete, kinds=("parameters",), metavar="NODE")
        for word in words:
            argument = parser.add_argument(word, metavar=word.upper())
            if word == "parameter":
                complete(argument, "parameters")
        if name == "set":
            kinds = "bool, integer, double or string, byte_array, ...: which it must have, else the one that it shows"
            complete(parser.add_argument("--type", default="", metavar="TYPE", help=kinds), "parameter_types")
