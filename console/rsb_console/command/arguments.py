"""The arguments of the command `rsb-console`."""

from __future__ import annotations

import argparse
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from rsb_bridge.installed_features import features_with, guarded, leave_taken
from rsb_bridge.model.text import is_clean
from rsb_console.command.bridge_arguments import add_bridge_commands
from rsb_console.command.call_arguments import add_call_command
from rsb_console.command.client_arguments import add_client_commands
from rsb_console.command.command_parser import CommandParser
from rsb_console.command.local_arguments import add_completion, add_local_commands
from rsb_console.command.topic_arguments import add_topic_commands
from rsb_console.command.watching_arguments import add_watching_commands
from rsb_console.library_internals.argparse_internals import Subcommands, commands_of, put_in_order

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.feature import Feature
    from rsb_console.command.remote_arguments import AddCommand

EPILOG = """\
Without a command: `rsb-console SESSION` bridges that session, `rsb-console` alone opens the console to choose one.

exit codes, of every command:
  0    done; nothing is wrong
  1    not done, or something is wrong
  2    wrong usage: bad arguments, a name that does not exist, a session file with mistakes
  3    not here: no such bridge runs, or a key file is missing (check)
  4    the session runs on this machine already
  129  the terminal has gone
  130  interrupted (Ctrl-C)
  143  terminated"""
_DEBUG = "show a failure's traceback"
_OF_CORE = (
    add_local_commands,
    add_bridge_commands,
    add_topic_commands,
    add_watching_commands,
    add_call_command,
    add_client_commands,
)


def parser_and_commands() -> tuple[argparse.ArgumentParser, list[str]]:
    """Return the parser and the names of the commands; parsed arguments have the function to run as `command`."""
    debug = CommandParser(add_help=False)
    # Without SUPPRESS, the default of a command's parser would overwrite a --debug before the command.
    debug.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=_DEBUG)
    parser = argparse.ArgumentParser(
        prog="rsb-console",
        description="Bridge ROS 2 topics, services and actions over encrypted sockets, and watch them flow.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[debug],
    )
    shown = f"rsb-console {version('rsb-console')}"  # `cli` shows it, too, without all this
    parser.add_argument("--version", action="version", version=shown, help="show the version and exit")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=CommandParser)

    def command(
        name: str, run: Callable[[argparse.Namespace], int], summary: str, more: str = "", after: str = ""
    ) -> argparse.ArgumentParser:
        added = subparsers.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=more,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            parents=[debug],
        )
        added.set_defaults(command=run)
        if after:
            places[name] = after
        return added

    places: dict[str, str] = {}

    for add in _OF_CORE:
        add(command, _complete)
    owners = dict.fromkeys((*subparsers.choices, "completion"), "the core")
    for feature in features_with("subcommands"):
        with guarded(feature, "subcommands"):
            feature.subcommands(_of_feature(feature, command, owners), _complete)
    add_completion(command, _complete)
    _place(subparsers, places)
    for feature in features_with("options"):
        with guarded(feature, "options"):
            feature.options(subparsers.choices, _complete)
    # A session file may take a command's place: `rsb-console SESSION` runs it.
    _complete(subparsers, "yaml_files")
    for added in subparsers.choices.values():
        _add_debug(added)
    return parser, list(subparsers.choices)


def _of_feature(feature: Feature, command: AddCommand, owners: dict[str, str]) -> AddCommand:
    """Return what adds a feature's commands, but none by a name that another one owns."""

    def add(name: str, *arguments: Any, **more: Any) -> argparse.ArgumentParser:
        if name in owners:
            leave_taken(feature, "subcommands", name, owners[name])
            return CommandParser(name)  # which nothing calls
        owners[name] = f"the feature {feature.name}"
        return command(name, *arguments, **more)

    return add


def _place(subparsers: Subcommands[CommandParser], places: dict[str, str]) -> None:
    """Move commands behind others, by name; one whose place has to move itself, after that."""
    while places:
        name = next((each for each, place in places.items() if place not in places), next(iter(places)))
        place, names = places.pop(name), list(subparsers.choices)
        if place in names:
            names.remove(name)
            names.insert(names.index(place) + 1, name)
            put_in_order(subparsers, names)


def _add_debug(parser: argparse.ArgumentParser) -> None:
    """Add --debug to the subcommands of a command, for example `client list`."""
    for nested in (commands_of(parser) or {}).values():
        nested.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=_DEBUG)
        _add_debug(nested)


def _complete(action: argparse.Action, completer: str) -> None:
    """Complete an argument with a function of `rsb_console.command.completion`, or ``package.module:function``."""
    module, _, function = completer.rpartition(":")

    def offers(**known: object) -> list[str]:
        completion = import_module(module or "rsb_console.command.completion")  # only while a shell completes
        found: list[str] = getattr(completion, function)(**known)
        return [each for each in found if is_clean(each)]  # a shell prints them as they are

    action.completer = offers  # type: ignore[attr-defined]  # argcomplete's own
