"""The arguments of the command ``param``, and the keys of its screen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, KeyChapter, bridge_commands, side_options, subcommand
from rsb_extras.node_control.parameter_types import PARAMETER_TYPES

if TYPE_CHECKING:
    from argparse import ArgumentParser

    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
The node may be of either side: the bridge of its side asks it. Of the other side's
nodes, this side may read and set those that are bridged (rsb-console add
--parameters), and those that the session file of their machine names (may). A
change asks first, and shows the old value and the new one.

for example:
  rsb-console param list /lidar_driver
  rsb-console param set /lidar_driver frame base_laser
  rsb-console param dump /lidar_driver --output lidar.yaml
  rsb-console param diff /lidar_driver lidar.yaml

exit codes:
  0  done; for diff, nothing differs
  1  the node or the bridge refused or did not answer; for diff, something differs
{NO_BRIDGE}"""
_COMMANDS = {
    "list": "list the nodes with parameters, or a node's parameters with what may be set",
    "get": "print a value, or several as YAML",
    "describe": "print types, ranges, read-only marks and descriptions",
    "set": "set one parameter or several, all or none",
    "dump": "print all parameters as YAML, as ros2 param dump does",
    "diff": "show what a file would change",
    "load": "set what differs in a file, all or nothing",
}
CHAPTERS = (
    KeyChapter(
        "Parameters (p on a node)", "ParametersScreen",
        (
            ("⏎", "Edit the parameter; its new value is asked for before it is set"),
            ("/ c", "Filter by name, value, type and description; only those that have changed since"),
            ("r", "Read all again"),
            ("esc", "Drop the filters, then close"),
        ),
    ),
)  # fmt: skip


def add_param(add: AddCommand, complete: Complete) -> None:
    summary = "list, set, save and load the parameters of either side's nodes"
    module = "rsb_extras.node_control.param_command"
    parent = add("param", subcommand(f"{module}:list_all"), summary, _MORE)
    for name, parser in bridge_commands(parent, complete, module, _COMMANDS):
        node = parser.add_argument("node", metavar="NODE", nargs="?" if name == "list" else None, help="its full name")
        complete(node, "rsb_extras.node_control.target_names:nodes_with_parameters")
        _add_words(parser, complete, name)
        side_options(parser, complete, "the node", "such a node")
        if name in ("set", "load"):
            parser.add_argument("--yes", action="store_true", help="do not ask")


def _add_words(parser: ArgumentParser, complete: Complete, name: str) -> None:
    completer = "rsb_extras.node_control.target_names:parameter_names"
    if name in ("get", "describe"):
        count = "+" if name == "get" else "*"
        complete(parser.add_argument("names", nargs=count, metavar="NAME", help="the parameters"), completer)
    elif name == "set":
        about = "a parameter and its value in YAML, as 0.5, true, text or [1, 2]; then further ones"
        complete(parser.add_argument("pairs", nargs="+", metavar="NAME VALUE", help=about), completer)
        about = "the values' type, for parameters that may have any, and for such as the node has not yet"
        parser.add_argument("--type", default="", choices=PARAMETER_TYPES[1:], metavar="TYPE", help=about)
    elif name == "dump":
        parser.add_argument("--output", type=Path, metavar="FILE", help="the file to write")
    elif name in ("diff", "load"):
        about = "as ros2 param dump writes it, with /** or the node's name"
        complete(parser.add_argument("file", type=Path, metavar="FILE", help=about), "yaml_files")
