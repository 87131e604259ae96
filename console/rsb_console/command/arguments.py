"""The arguments of the command `rsb-console`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.keys import DEFAULT_KEY_FILE
from rsb_bridge.feature import installed
from rsb_bridge.model.text import is_clean
from rsb_console.command import local_commands
from rsb_console.command.argument_values import count, seconds
from rsb_console.command.check import check_session
from rsb_console.command.remote_arguments import (
    CommandParser,
    add_call_commands,
    add_client_commands,
    add_fleet_commands,
    add_remote_commands,
    lazily,
    say_what_runs,
)

if TYPE_CHECKING:
    from collections.abc import Callable


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


_COMPLETION = """\
once, if the package's files are not in the shell's own folders:
  echo 'eval "$(rsb-console completion bash)"' >> ~/.bashrc
  echo 'eval "$(rsb-console completion zsh)"' >> ~/.zshrc       # after compinit
  echo 'rsb-console completion fish | source' >> ~/.config/fish/config.fish"""


_DEBUG = "show a failure's traceback"


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
    parser.add_argument("--version", action="store_true", help="show the version and exit")  # as `cli` does
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
            _place_after(subparsers, after)
        return added

    _run_arguments(command("run", local_commands.run, "bridge a session, with or without the console"))
    check = command("check", check_session, "describe a session and its mistakes")
    _complete(check.add_argument("session", type=Path, metavar="SESSION", help="session file"), "yaml_files")
    check.add_argument("--json", action="store_true", help="print JSON, for programs")
    keygen = command("keygen", local_commands.keygen, "create a key for both sides of a link")
    keygen.add_argument(
        "path", type=Path, metavar="PATH", nargs="?", default=Path(DEFAULT_KEY_FILE), help="key file (%(default)s)"
    )
    keygen.add_argument("--force", action="store_true", help="replace an existing key file")
    _import_arguments(command("import", local_commands.import_sessions, "convert another bridge's file to a session"))
    scan = command("bt-scan", lazily("bt-scan", "bt_scan"), "list Bluetooth adapters and their busy RFCOMM channels")
    only = scan.add_argument("--adapter", metavar="NAME", help="only this one: hci0, or its MAC")
    _complete(only, "adapters")
    scan.add_argument("--json", action="store_true", help="print JSON, for programs")
    demo = command("demo", local_commands.demo, "bridge two ROS domains on this machine, with a simulated robot")
    demo.add_argument("--no-ui", action="store_true", help="print the log, without the console")
    demo.add_argument("--seconds", type=seconds, metavar="N", help="stop after N s")
    demo.add_argument("--fleet", action="store_true", help="the fleet's screen on several simulated robots instead")
    demo.add_argument(
        "--robots", type=count, metavar="N", default=8, help="with --fleet: number of robots (%(default)s)"
    )
    _service_arguments(command("service", lazily("show", "service"), "run a session as a service of systemd"))
    add_remote_commands(command, _complete, _console_options)
    add_call_commands(command, _complete)
    add_client_commands(command, _complete)
    run_in_fleet = add_fleet_commands(command, _complete, _console_options)
    for feature in installed():
        feature.subcommands(command, _complete)
    say_what_runs(run_in_fleet, subparsers.choices)
    summary = "print the completion script for a shell"
    script = command("completion", local_commands.completion, summary, _COMPLETION)
    script.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "fish"), help="bash, zsh or fish")
    # A session file may take a command's place: `rsb-console SESSION` runs it.
    _complete(subparsers, "yaml_files")
    for added in subparsers.choices.values():
        _add_debug(added)
    return parser, list(subparsers.choices)


def _place_after(subparsers: argparse._SubParsersAction[CommandParser], name: str) -> None:
    """Move the command that was added last behind the one of this name."""
    known = list(subparsers.choices.items())
    if name in subparsers.choices:
        place = list(subparsers.choices).index(name) + 1
        known.insert(place, known.pop())
        subparsers._choices_actions.insert(place, subparsers._choices_actions.pop())
        subparsers._name_parser_map.clear()
        subparsers._name_parser_map.update(known)


def _add_debug(parser: argparse.ArgumentParser) -> None:
    """Add --debug to the subcommands of a command, for example `client list`."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for nested in action.choices.values():
                nested.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=_DEBUG)
                _add_debug(nested)


def _complete(action: argparse.Action, completer: str) -> None:
    """Complete an argument with a function of `rsb_console.command.completion`."""

    def offers(**known: object) -> list[str]:
        from rsb_console.command import completion  # noqa: PLC0415 (only while a shell completes)

        found: list[str] = getattr(completion, completer)(**known)
        return [each for each in found if is_clean(each)]  # a shell prints them as they are

    action.completer = offers  # type: ignore[attr-defined]  # argcomplete's own


def _run_arguments(parser: argparse.ArgumentParser) -> None:
    _complete(
        parser.add_argument(
            "session", type=Path, metavar="SESSION", nargs="?", help="session file; default: choose one"
        ),
        "yaml_files",
    )
    parser.add_argument("--no-ui", action="store_true", help="print the log, without the console")
    parser.add_argument(
        "--log-format", choices=("text", "json"), default="text", help="with --no-ui: of the log (%(default)s)"
    )
    parser.add_argument(
        "--status-every", type=seconds, default=5.0, metavar="N", help="with --no-ui: print the status every N s (5)"
    )
    parser.add_argument(
        "--on-hangup", choices=("stop", "continue"), default="stop", help="if the terminal goes away (%(default)s)"
    )
    parser.add_argument("--control", type=Path, metavar="PATH", help="path of the control socket to serve")
    _console_options(parser)


def _service_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    for name, summary in (
        ("install", "write the session's unit and print the next commands"),
        ("show", "print the session's unit"),
        ("uninstall", "remove the session's unit"),
    ):
        action = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        action.set_defaults(command=lazily(name, "service"))
        _complete(action.add_argument("session", type=Path, metavar="SESSION", help="session file"), "yaml_files")
        action.add_argument("--system", action="store_true", help="a system service, not one of this user")
        if name != "show":
            action.add_argument("--force", action="store_true", help="overwrite or remove a foreign unit, too")
        if name != "uninstall":
            action.add_argument("--setup", type=Path, metavar="PATH", help="setup.bash of a workspace, sourced first")


def _console_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--readonly", action="store_true", help="read-only: nothing can be changed")
    parser.add_argument("--ascii", action="store_true", help="draw with ASCII characters")
    parser.add_argument("--no-mouse", action="store_true", help="leave the mouse to the terminal (m takes it back)")
    _complete(parser.add_argument("--theme", metavar="NAME", help="theme to start with"), "theme_names")


def _import_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "FILE is config/bringup.yaml of ros2_socket_bridge, a configuration of domain_bridge (of which each pair of "
        "domains becomes two sessions), or one of zenoh-bridge-ros2dds. What cannot be carried over is printed, and "
        "written into the session as comments."
    )
    _complete(parser.add_argument("file", type=Path, metavar="FILE", help="file to convert"), "yaml_files")
    parser.add_argument("--name", help="name of the bridge; default: the file's, if it has one")
    parser.add_argument("--role", choices=("client", "server"), help="default: as the file has it")
    parser.add_argument("--key-file", type=Path, metavar="PATH", help="file with the key")
    parser.add_argument("--port", type=int, help="port of the server; default: the file's, or 7060")
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain; default: the file's, or $ROS_DOMAIN_ID")
    parser.add_argument("--use-name", action="store_true", help="prefix the client's topics on the server")
    parser.add_argument("--no-encryption", action="store_true", help="all data crosses unencrypted")
    _complete(
        parser.add_argument(
            "-o", "--output", type=Path, metavar="PATH", help="file, or folder for several; default: standard output"
        ),
        "yaml_files",
    )
    parser.add_argument("--force", action="store_true", help="replace existing session files")
