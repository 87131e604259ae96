"""The arguments of the command ``component``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, bridge_commands, side_options, subcommand

if TYPE_CHECKING:
    from argparse import ArgumentParser

    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
A container is a process that loads and unloads nodes, its components: rclcpp's
component_container, and nav2_container. What this side may change there, the
session file of the container's machine says (may); the right to a container is
that to all its components. A change asks first.

for example:
  rsb-console component list
  rsb-console component load /nav2_container nav2_planner nav2_planner::PlannerServer
  rsb-console component unload /nav2_container /planner_server

exit codes:
  0  listed, or done
  1  the container or the bridge refused or did not answer
{NO_BRIDGE}"""
_COMMANDS = {
    "list": "list containers with their components",
    "load": "load a component into a container",
    "unload": "unload a component, which ends its node",
}


def add_component(add: AddCommand, complete: Complete) -> None:
    summary = "list, load and unload components of either side's containers"
    module = "rsb_extras.node_control.component_command"
    parent = add("component", subcommand(f"{module}:list_all"), summary, _MORE)
    for name, parser in bridge_commands(parent, complete, module, _COMMANDS):
        count = "?" if name == "list" else None
        container = parser.add_argument("node", metavar="CONTAINER", nargs=count, help="its full name")
        complete(container, "rsb_extras.node_control.target_names:containers")
        _add_words(parser, complete, name)
        side_options(parser, complete, "the container", "such a container")
        if name != "list":
            parser.add_argument("--yes", action="store_true", help="do not ask")


def _add_words(parser: ArgumentParser, complete: Complete, name: str) -> None:
    if name == "unload":
        component = parser.add_argument("component", metavar="NODE", help="the component's full name")
        complete(component, "rsb_extras.node_control.target_names:components")
    elif name == "load":
        parser.add_argument("package", metavar="PACKAGE", help="the component's package")
        parser.add_argument("plugin", metavar="PLUGIN", help="its class there, as package::Class")
        parser.add_argument("--name", default="", help="its node's name, instead of its own")
        parser.add_argument("--namespace", default="", help="its node's namespace")
        about = "rename a topic or service of it, as from:=to; may be repeated"
        parser.add_argument("--remap", action="append", default=[], metavar="RULE", help=about)
        about = "a parameter of it, as name:=value, in YAML; may be repeated"
        parser.add_argument("--param", action="append", default=[], metavar="RULE", help=about)
        about = "hand its messages to others of the container directly (use_intra_process_comms)"
        parser.add_argument("--intra-process", action="store_true", help=about)
