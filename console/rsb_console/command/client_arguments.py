"""The arguments of `client` and its own commands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.command.remote_arguments import subcommand

if TYPE_CHECKING:
    import argparse

    from rsb_console.command.remote_arguments import AddCommand, Complete


def add_client_commands(command: AddCommand, complete: Complete) -> None:
    parent = command(
        "client",
        subcommand("client_command:list_clients"),
        "add, remove, list and rekey a server's clients",
    )
    commands = parent.add_subparsers(metavar="COMMAND", required=True)

    def client(name: str, summary: str, *, named: bool = True, hands_out: bool = False) -> argparse.ArgumentParser:
        parser = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        function = "list_clients" if name == "list" else f"{name}_client"
        parser.set_defaults(command=subcommand(f"client_command:{function}"), saves=name != "show")
        which = "the server's session file, or its bridge's name; default: the server that runs here"
        complete(parser.add_argument("session", type=Path, metavar="SERVER", nargs="?", help=which), "yaml_files")
        if named:
            its_name = parser.add_argument("name", metavar="NAME", help="name of the client")
            if name != "add":
                complete(its_name, "links")
        complete(
            parser.add_argument("--bridge", metavar="BRIDGE", help="the server's bridge; needed where several run"),
            "bridge_names",
        )
        parser.add_argument("--control", type=Path, metavar="PATH", help="the bridge's control socket")
        parser.add_argument("--json", action="store_true", help="print JSON, for programs")
        if hands_out:
            parser.add_argument(
                "--address",
                default="",
                metavar="ADDRESS",
                help="the server's address, as the client reaches it; with :PORT if that differs",
            )
            output = "the client's session file to write; default: standard output"
            parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=output)
        return parser

    add = client("add", "accept one more client: create its key and print its session file", hands_out=True)
    add.add_argument("--key-file", metavar="PATH", help="its key file, created if missing; default: NAME.key")
    prefix = add.add_mutually_exclusive_group()
    prefix.add_argument(
        "--prefix", dest="use_name", action="store_true", default=None, help="prefix its topics with NAME"
    )
    prefix.add_argument(
        "--no-prefix", dest="use_name", action="store_false", default=None, help="do not prefix its topics"
    )
    for option, pattern in (("--allow", "topics"), ("--deny", "topics and services")):
        entries = f"a pattern of {pattern}, or a mapping as in a session file; may be repeated"
        add.add_argument(option, action="append", default=[], metavar="PATTERN", help=entries)
    client("remove", "stop accepting a client; its key file stays")
    client("list", "list the clients, with the fingerprints of their keys", named=False)
    rekey = client("rekey", "create a new key for a client and print its session file", hands_out=True)
    steps = rekey.add_mutually_exclusive_group()
    keep = "keep the link: both keys are valid until --finish"
    steps.add_argument("--keep-old", action="store_true", help=keep)
    finish = "end a rotation once the client has the new key: the old key becomes invalid"
    steps.add_argument("--finish", action="store_true", help=finish)
    rekey.add_argument("--yes", action="store_true", help="with --finish: do not ask, though the client is not linked")
    client("show", "print a client's session file again", hands_out=True)
