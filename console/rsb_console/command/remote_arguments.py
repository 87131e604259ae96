"""Common ground of subcommands: how to add them, and arguments that name a bridge or a topic."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

from rsb_console.command.ways import ways
from rsb_console.library_internals.argparse_internals import actions_of, forget_default

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

Complete: TypeAlias = "Callable[[argparse.Action, str], None]"
KINDS = ("topic", "service", "action", "parameters")


class AddCommand(Protocol):
    def __call__(
        self, name: str, run: Callable[[argparse.Namespace], int], summary: str, more: str = "", after: str = ""
    ) -> argparse.ArgumentParser:
        """Add a command by its name, the function that runs it, a summary and the end of its help.

        Lists have it after the command `after`, or at the end.
        """


NO_BRIDGE = """\
  2  wrong usage: bad arguments, no such topic, several bridges and no --bridge,
     or a question that nobody is there to answer
  3  no such bridge runs, or it cannot be reached"""
EXIT = f"""\
exit codes:
  0  done
  1  the bridge refused, or did not answer
{NO_BRIDGE}"""


def subcommand(place: str) -> Callable[[argparse.Namespace], int]:
    """Return a function that imports a command when it is run, and reports its errors.

    Its place is ``package.module:function``, or ``module:function`` of `rsb_console.command`.
    """
    module, function = place.split(":")
    if "." not in module:
        module = f"rsb_console.command.{module}"

    def run(arguments: argparse.Namespace) -> int:
        try:
            code: int = getattr(import_module(module), function)(arguments)
        except Exception as error:  # noqa: BLE001 -- `reported` raises again what is no command's
            # Only now: it imports what attaches, and each new shell waits for `completion`.
            from rsb_console.command.target import reported  # noqa: PLC0415

            return reported(error, arguments)
        return code

    return run


def bridge_command(
    command: AddCommand,
    complete: Complete,
    name: str,
    place: str,
    summary: str,
    more: str = EXIT,
    *,
    after: str = "",
) -> argparse.ArgumentParser:
    """Add a command for a running bridge, named by ``--bridge`` or a plain word, and run by the function at `place`."""
    parser = command(name, subcommand(place), summary, more, after)
    named_bridge_options(parser, complete)
    return parser


def route_command(
    command: AddCommand,
    complete: Complete,
    name: str,
    place: str,
    summary: str,
    more: str = EXIT,
    *,
    after: str = "",
    kinds: tuple[str, ...] = KINDS,
    metavar: str = "NAME",
) -> argparse.ArgumentParser:
    """Add a command for one bridged topic, service, action or node of these kinds, named by a plain word."""
    parser = command(name, subcommand(place), summary, more, after)
    bridge_options(parser, complete)
    route_arguments(parser, complete, kinds, metavar)
    return parser


def place_options(parser: argparse.ArgumentParser, complete: Complete, *, all_bridges: bool = False) -> None:
    """Add the options that locate a bridge, or all bridges of a fleet, in other ways than by a name."""
    parser.add_argument("--control", type=Path, metavar="PATH", help="the bridge's control socket, instead of NAME")
    parser.set_defaults(way=None)
    for way in ways():
        told = way.many if all_bridges else way.one
        complete(parser.add_argument(way.option, dest="way", type=way, metavar="FILE", help=told), "yaml_files")


def bridge_options(
    parser: argparse.ArgumentParser,
    complete: Complete,
    *,
    json: bool = True,
    which: str = "the bridge, by the name that `status` prints; needed where several run. NAME may come first, too",
    all_bridges: bool = False,
) -> None:
    """Add the options of every command that attaches: the choice of the bridge and ``--json``."""
    complete(parser.add_argument("--bridge", metavar="NAME", help=which), "bridge_names")
    place_options(parser, complete, all_bridges=all_bridges)
    if json:
        parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def side_options(parser: argparse.ArgumentParser, complete: Complete, what: str, such: str) -> None:
    """Add the options that choose a side if several have `what`, or both sides have `such`."""
    which = f"the client, if several have {what}"
    complete(parser.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    parser.add_argument("--here", action="store_true", help=f"the bridge's own side, if both have {such}")


def inherit_bridge_options(parser: argparse.ArgumentParser) -> None:
    """Let the options of a command's own command be given to the command, too: without them, its values count."""
    for option in actions_of(parser):
        if option.dest in ("bridge", "control", "way", "json"):
            option.default = argparse.SUPPRESS
            forget_default(parser, option.dest)


def bridge_commands(
    parent: argparse.ArgumentParser, complete: Complete, module: str, commands: Mapping[str, str]
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Add commands for a running bridge to a command, and yield them with their names: each takes words of its own.

    Args:
        module: has the function that runs each, its name and ``_all``.
        commands: what each does, by name.
    """
    bridge_options(parent, complete)
    parsers = parent.add_subparsers(metavar="COMMAND", required=True)
    for name, about in commands.items():
        parser = parsers.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        parser.set_defaults(command=subcommand(f"{module}:{name}_all"), in_fleet=True)
        bridge_options(parser, complete)
        inherit_bridge_options(parser)
        yield name, parser


def named_bridge_options(parser: argparse.ArgumentParser, complete: Complete, *, json: bool = True) -> None:
    """Add the same, and the bridge's name as a plain word, to a command that takes no other one."""
    alone = parser.add_argument(
        "bridge", metavar="NAME", nargs="?", default=argparse.SUPPRESS, help="short for --bridge NAME"
    )
    complete(alone, "bridge_names")
    bridge_options(parser, complete, json=json)


def route_arguments(
    parser: argparse.ArgumentParser, complete: Complete, kinds: tuple[str, ...] = KINDS, metavar: str = "NAME"
) -> None:
    """Add the arguments of `route_command`."""
    name = "the name on this bridge's side, or on the client"
    complete(parser.add_argument("topic", metavar=metavar, help=name), "bridged")
    which = "the client, if several have it"
    complete(parser.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    parser.add_argument("--direction", choices=("transmit", "receive"), help="the direction, if it crosses both ways")
    far = "its name on the other side, if several have this name"
    complete(parser.add_argument("--remote", metavar="NAME", help=far), "far_names")
    parser.set_defaults(kinds=kinds, kind=None)
    if len(kinds) > 1:
        kind_option(parser, "the kind, if several have this name", kinds)


def kind_option(parser: argparse.ArgumentParser, about: str, kinds: tuple[str, ...] = KINDS) -> None:
    parser.add_argument("--kind", choices=kinds, help=about)


def drop_arm_option(parser: argparse.ArgumentParser, about: str) -> None:
    parser.add_argument("--drop-arm", action="store_true", help=about)


def console_options(parser: argparse.ArgumentParser, complete: Complete) -> None:
    parser.add_argument("--readonly", action="store_true", help="read-only: nothing can be changed")
    parser.add_argument("--ascii", action="store_true", help="draw with ASCII characters")
    parser.add_argument("--no-mouse", action="store_true", help="leave the mouse to the terminal (m takes it back)")
    complete(parser.add_argument("--theme", metavar="NAME", help="theme to start with"), "theme_names")
