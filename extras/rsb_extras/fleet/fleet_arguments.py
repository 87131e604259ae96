"""The arguments of `fleet` and its own commands."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rsb_console.command.command_parser import CommandParser
from rsb_console.command.remote_arguments import console_options
from rsb_console.feature_console import bridge_options, count, inherit_bridge_options, seconds, subcommand
from rsb_console.library_internals.argparse_internals import Subcommands, commands_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_console.feature_console import AddCommand, Complete

_NO_SERVER = """\
  2  wrong usage: bad arguments, no such robot or group
  3  no server runs here that you may attach to, or it or the fleet is not reached"""
_WHICH_SERVER = "only the robots of this server, by the name that `status` prints. `fleet NAME` is short for it"
_FLEET = f"""\
It shows the robots of all servers that run here; with --fleet, all bridges of a fleet
over Zenoh.

Without --json, it opens the screen of all robots. A robot that is missing, or
has a fault or a warning, counts as wrong; one that was never connected does not.

exit codes, with --json:
  0  nothing is wrong
  1  something is wrong with a robot; its state names it
{_NO_SERVER}"""
_DISMISS = f"""\
exit codes:
  0  done
{_NO_SERVER}"""
_EXEC = f"""\
COMMAND is one of the commands that show or change a bridge, with its arguments:
{{commands}}. Topics have the
robot's own names. No shell is involved.

for example:
  rsb-console fleet exec robot1 robot2 -- pause /camera
  rsb-console fleet exec --group hall -- status
  rsb-console fleet exec --all -- echo /battery_state --once --timeout 5

exit codes:
  0  done, for every robot
  1  not done for one of them; the output names it
{_NO_SERVER}"""
_EDIT = f"""\
First it prints the changes for each robot and asks. Then it changes one robot after
the other. After each, it waits until the robot has been as well as before for --settle
seconds. It stops at the first robot that gets worse, or after the present robot on
Ctrl-C. Then it prints the reason, the robots done and not done, and the way back.

for example:
  rsb-console fleet edit --group hall /camera max_rate=5 --dry-run
  rsb-console fleet edit robot1 robot2 /camera max_rate=5 compression=zstd

exit codes:
  0  done on every robot that has the topic, or no change was necessary
  1  stopped, declined, or a robot was not reached; with --dry-run: it would fail on one
{_NO_SERVER}"""
_IN_FLEET = (
    "status", "topics", "add", "edit", "remove", "pause", "resume", "ack", "disarm", "retry", "events", "echo", "hz",
    "bw", "info", "wait", "call",
)  # fmt: skip
"""Commands of the core that `exec` runs."""


def add_fleet_commands(command: AddCommand, complete: Complete) -> None:
    """Add `fleet` and its own commands."""
    fleet = command(
        "fleet", subcommand("rsb_extras.fleet.fleet_command:show_fleet"), "show all robots on one screen", _FLEET
    )
    bridge_options(fleet, complete, which=_WHICH_SERVER, all_bridges=True)
    fleet.add_argument(
        "--seconds",
        type=seconds,
        default=2.0,
        metavar="N",
        help="with --json: observe the loss for N s (2)",
    )
    console_options(fleet, complete)
    commands = fleet.add_subparsers(metavar="COMMAND", parser_class=_FleetParser)
    forget = _add_fleet_command(
        commands, complete, "dismiss", "dismiss_robots", "forget robots that are gone for good", _DISMISS
    )
    complete(
        forget.add_argument("names", metavar="NAME", nargs="*", help="robots"), "rsb_extras.fleet.fleet_names:robots"
    )
    run = _add_fleet_command(commands, complete, "exec", "execute", "run a command for some robots", _EXEC)
    complete(run.add_argument("names", metavar="NAME", nargs="*", help="robots"), "rsb_extras.fleet.fleet_names:robots")
    run.usage = "rsb-console fleet exec [NAME ...] [--group GROUP] [--all] [--fleet FILE] [--json] -- COMMAND ..."
    edit = _add_fleet_command(
        commands, complete, "edit", "edit_robots", "change a topic of some robots, one after the other", _EDIT
    )
    words = edit.add_argument(
        "names", metavar="NAME|TOPIC|KEY=VALUE", nargs="*", help="robots, a topic, and its changes"
    )
    complete(words, "rsb_extras.fleet.fleet_names:robots")
    edit.add_argument("--dry-run", action="store_true", help="only print what would change")
    edit.add_argument("--yes", action="store_true", help="do not ask")
    edit.add_argument("--undo", action="store_true", help="when it stops, restore the previous settings without asking")
    edit.add_argument(
        "--settle", type=seconds, default=10.0, metavar="N", help="seconds that a robot has to stay well (10)"
    )


def say_what_runs(commands: Mapping[str, argparse.ArgumentParser]) -> None:
    """Have the parser of `fleet exec` know which of all commands it runs."""
    run = (commands_of(commands["fleet"]) or {})["exec"]
    able = [*_IN_FLEET, *(name for name, each in commands.items() if each.get_default("in_fleet"))]
    run.set_defaults(able=able)
    run.epilog = _EXEC.replace("{commands}", f"{', '.join(able[:8])},\n{', '.join(able[8:])}")


def add_demo_options(demo: argparse.ArgumentParser) -> None:
    run = subcommand("rsb_extras.fleet.fleet_demo:demo")
    told = "the fleet's screen on several simulated robots instead"
    demo.add_argument("--fleet", action="store_const", dest="command", const=run, help=told)
    demo.add_argument(
        "--robots", type=count, metavar="N", default=8, help="with --fleet: number of robots (%(default)s)"
    )


def _add_fleet_command(
    commands: Subcommands[_FleetParser],
    complete: Complete,
    name: str,
    function: str,
    summary: str,
    more: str,
) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        epilog=more,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(command=subcommand(f"rsb_extras.fleet.fleet_command:{function}"))
    bridge_options(parser, complete, which=_WHICH_SERVER, all_bridges=True)
    inherit_bridge_options(parser)
    in_group = parser.add_argument("--group", default="", metavar="GROUP", help="also all robots of this group")
    complete(in_group, "rsb_extras.fleet.fleet_names:groups")
    parser.add_argument("--all", dest="everyone", action="store_true", help="all robots")
    return parser


class _FleetParser(CommandParser):
    """Leaves the words after ``--`` as they are: they have their own options."""

    def parse_known_args(  # type: ignore[override]  # as above
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        own, words = list(args or ()), []
        if "--" in own:
            at = own.index("--")
            own, words = own[:at], own[at + 1 :]
        found, unknown = super().parse_known_args(own, namespace)
        found.words = words
        return found, unknown
