"""The arguments of the commands that need no running bridge."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.keys import DEFAULT_KEY_FILE
from rsb_console.command.argument_values import seconds
from rsb_console.command.remote_arguments import console_options, subcommand

if TYPE_CHECKING:
    import argparse

    from rsb_console.command.remote_arguments import AddCommand, Complete

_COMPLETION = """\
once, if the package's files are not in the shell's own folders:
  echo 'eval "$(rsb-console completion bash)"' >> ~/.bashrc
  echo 'eval "$(rsb-console completion zsh)"' >> ~/.zshrc       # after compinit
  echo 'rsb-console completion fish | source' >> ~/.config/fish/config.fish"""


def add_local_commands(command: AddCommand, complete: Complete) -> None:
    run = command("run", subcommand("local_commands:run"), "bridge a session, with or without the console")
    _run_arguments(run, complete)
    check = command("check", subcommand("check:check_session"), "describe a session and its mistakes")
    complete(check.add_argument("session", type=Path, metavar="SESSION", help="session file"), "yaml_files")
    check.add_argument("--json", action="store_true", help="print JSON, for programs")
    keygen = command("keygen", subcommand("local_commands:keygen"), "create a key for both sides of a link")
    keygen.add_argument(
        "path", type=Path, metavar="PATH", nargs="?", default=Path(DEFAULT_KEY_FILE), help="key file (%(default)s)"
    )
    keygen.add_argument("--force", action="store_true", help="replace an existing key file")
    summary = "list Bluetooth adapters and their busy RFCOMM channels"
    scan = command("bt-scan", subcommand("bt_scan:scan_bluetooth"), summary)
    only = scan.add_argument("--adapter", metavar="NAME", help="only this one: hci0, or its MAC")
    complete(only, "adapters")
    scan.add_argument("--json", action="store_true", help="print JSON, for programs")


def _run_arguments(parser: argparse.ArgumentParser, complete: Complete) -> None:
    complete(
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
    console_options(parser, complete)


def add_completion(command: AddCommand, _: Complete) -> None:
    summary = "print the completion script for a shell"
    script = command("completion", subcommand("local_commands:completion"), summary, _COMPLETION)
    script.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "fish"), help="bash, zsh or fish")
