"""The arguments of `fleet` and its own commands."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rsb_console.command.remote_arguments import bridge_options, lazily
from rsb_console.command.values import seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_console.command.remote_arguments import AddCommand, Complete

_NO_SERVER = """\
  2  wrong usage: bad arguments, no such robot or group
  3  no server runs here that you may attach to, or it or the fleet is not reached"""
_WHICH = "only the robots of this server, by the name that `status` prints"
_OVER = "a fleet file: all bridges of that fleet, over Zenoh, instead of the servers here"
_FLEET = f"""\
The robots are those of all servers that run here; with --fleet, all bridges of a
fleet over Zenoh.

Without --json, it opens the screen of all robots. A robot that is missing, or
has a fault or a warning, is wrong; one that has never been there is not.

exit codes, with --json:
  0  nothing is wrong
  1  something is wrong with a robot: its state says what
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
  1  not done for one of them: it is named
{_NO_SERVER}"""
_EDIT = f"""\
First it prints what would change on each robot, and asks. Then it changes one robot
after the other. After each, it waits until the robot has been as well as before for
--settle seconds, and stops at the first that gets worse: it says which, and why, what
is done and what is not, and how to go back. So it does on Ctrl-C, after the present
robot.

for example:
  rsb-console fleet edit --group hall /camera max_rate=5 --dry-run
  rsb-console fleet edit robot1 robot2 /camera max_rate=5 compression=zstd

exit codes:
  0  done on every robot that has the topic; or nothing is to change
  1  it has stopped, or was not wanted, or a robot was not reached; or with --dry-run,
     it cannot be done on one
{_NO_SERVER}"""
ALLOWED = (
    "status", "topics", "add", "edit", "remove", "pause", "resume", "ack", "disarm", "retry", "events", "echo", "hz",
    "bw", "info", "wait", "call", "param",
)  # fmt: skip
"""Commands that `exec` runs."""


def add_fleet_commands(
    command: AddCommand, complete: Complete, console_options: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Add `fleet` and its own commands; the arguments are those of `add_remote_commands`."""
    fleet = command("fleet", lazily("show", "fleet"), "show all robots on one screen", _FLEET)
    bridge_options(fleet, complete, which=_WHICH, over=_OVER)
    fleet.add_argument(
        "--seconds", type=seconds, default=2.0, metavar="N", help="with --json: look for N s, which loss is about (2)"
    )
    console_options(fleet)
    commands = fleet.add_subparsers(metavar="COMMAND", parser_class=_FleetParser)
    forget = _add(commands, complete, "dismiss", "forget robots that were there, and are known no more", _DISMISS)
    complete(forget.add_argument("names", metavar="NAME", nargs="*", help="robots"), "robots")
    listed = f"{', '.join(ALLOWED[:8])},\n{', '.join(ALLOWED[8:])}"
    run = _add(commands, complete, "exec", "run a command for some robots", _EXEC.replace("{commands}", listed))
    complete(run.add_argument("names", metavar="NAME", nargs="*", help="robots"), "robots")
    run.usage = "rsb-console fleet exec [NAME ...] [--group GROUP] [--all] [--fleet FILE] [--json] -- COMMAND ..."
    edit = _add(commands, complete, "edit", "change a topic of some robots, one after the other", _EDIT)
    words = edit.add_argument("names", metavar="NAME|TOPIC|KEY=VALUE", nargs="*", help="robots, topic, what to change")
    complete(words, "robots")
    edit.add_argument("--dry-run", action="store_true", help="only print what would change")
    edit.add_argument("--yes", action="store_true", help="do not ask")
    edit.add_argument(
        "--undo", action="store_true", help="where it stops, put back what was before, without a question"
    )
    edit.add_argument("--settle", type=seconds, default=10.0, metavar="N", help="s that a robot has to be well (10)")


def _add(
    commands: argparse._SubParsersAction[_FleetParser],
    complete: Complete,
    name: str,
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
    parser.set_defaults(command=lazily(name, "fleet"))
    bridge_options(parser, complete, which=_WHICH, over=_OVER)
    for option in parser._actions:
        if option.dest in ("bridge", "control", "fleet", "json"):
            option.default = argparse.SUPPRESS  # `fleet` has them, too: what stands there counts
    in_group = parser.add_argument("--group", default="", metavar="GROUP", help="all robots of this group, too")
    complete(in_group, "groups")
    parser.add_argument("--all", dest="everyone", action="store_true", help="all robots")
    return parser


class _FleetParser(argparse.ArgumentParser):
    """Leaves what follows ``--`` as it is: it has options of its own."""

    def parse_known_args(  # type: ignore[override]  # argparse's is overloaded, by the kind of namespace
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        own, words = list(args or ()), []
        if "--" in own:
            at = own.index("--")
            own, words = own[:at], own[at + 1 :]
        if self._subparsers is not None or not {"-h", "--help"}.isdisjoint(own) or self._mixes:
            return super().parse_known_args(own, namespace)
        self._mixes = True
        try:
            found, unknown = self.parse_known_intermixed_args(own, namespace)
        finally:
            self._mixes = False
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        found.words = words
        return found, []

    _mixes = False
