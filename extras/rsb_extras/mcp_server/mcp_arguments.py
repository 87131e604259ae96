"""The arguments of the command ``mcp``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, named_bridge_options, subcommand

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
A program starts it and speaks to it over its stdin and stdout; it ends with them.
Tools that move something (arm, drive, publish, call) do not exist here.

for example, in a program's list of servers:
  {{"command": "rsb-console", "args": ["mcp", "robot1"]}}

exit codes:
  0  the program has closed its end
  1  the package mcp is missing
{NO_BRIDGE}"""


def add_mcp(add: AddCommand, complete: Complete) -> None:
    summary = "let a program look at a running bridge, by the Model Context Protocol"
    parser = add("mcp", subcommand("rsb_extras.mcp_server.mcp_command:mcp"), summary, _MORE)
    named_bridge_options(parser, complete, json=False)
    changes = parser.add_mutually_exclusive_group()
    changes.add_argument("--read-only", action="store_true", help="offer no tool that changes anything (default)")
    allow = "also offer tools that add, remove, pause and resume topics"
    changes.add_argument("--allow-changes", action="store_true", help=allow)
