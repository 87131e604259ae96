"""The arguments of the commands that attach to a running bridge."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    AddCommand = Callable[[str, Callable[[argparse.Namespace], int], str], argparse.ArgumentParser]
    Complete = Callable[[argparse.Action, str], None]

TOPIC_KEYS = (
    "type=, protocol=, port=, qos=, remote_topic=, compression=, max_rate=, expected_rate=, stale_after=, paused="
)


def add_remote_commands(
    command: AddCommand,
    complete: Complete,
    attach: Callable[[argparse.Namespace], int],
    console_options: Callable[[argparse.ArgumentParser], None],
) -> None:
    """Add the commands.

    Args:
        command: adds one, by its name, what it runs, and a summary.
        complete: completes an argument with a function of `rsb_console.command.completion`.
        attach: what `attach` runs.
        console_options: adds the options of the console to a parser.
    """

    def remote(name: str, summary: str, *, bridge_first: bool = False) -> argparse.ArgumentParser:
        parser = command(name, attach if name == "attach" else _lazily(name), summary)
        which = "the bridge, as `rsb-console status` names it; needed where several run"
        if bridge_first:
            complete(parser.add_argument("bridge", metavar="NAME", nargs="?", help=which), "bridge_names")
        else:
            complete(parser.add_argument("--bridge", metavar="NAME", help=which), "bridge_names")
        parser.add_argument("--control", type=Path, metavar="PATH", help="the bridge's control socket, instead of NAME")
        if name != "attach":
            parser.add_argument("--json", action="store_true", help="for programs")
        return parser

    console_options(remote("attach", "open the console on a bridge that runs already", bridge_first=True))
    remote("status", "say how a running bridge is; exit code 1 if something is wrong", bridge_first=True)
    topics = remote("topics", "list a running bridge's topics", bridge_first=True)
    topics.add_argument("--available", action="store_true", help="those that can be bridged, on either side, instead")
    add = remote("add", "bridge one more topic")
    add.add_argument("topic", metavar="TOPIC", help="its name on the client")
    add.add_argument("direction", choices=("transmit", "receive"), help="as the client sees it")
    _topic_keys(add)
    add.add_argument("--link", default="", metavar="CLIENT", help="on a server of several: with which client")
    edit = remote("edit", "change a topic that is bridged")
    _route(edit)
    _topic_keys(edit)
    for name, summary in (
        ("remove", "stop bridging a topic, on both sides"),
        ("pause", "stop carrying a topic's messages, on both sides"),
        ("resume", "carry a paused topic's messages again"),
    ):
        _route(remote(name, summary))
    retry = remote("retry", "connect now, and open refused topics again", bridge_first=True)
    retry.add_argument("--link", default="", metavar="CLIENT", help="only this one")
    remote("restart", "close the links on both sides and open them again", bridge_first=True)
    reload = remote("reload", "read the session file again, and change only what differs", bridge_first=True)
    reload.add_argument("--dry-run", action="store_true", help="only print what would change")
    events = remote("events", "print what a running bridge reports", bridge_first=True)
    events.add_argument("--follow", action="store_true", help="go on with what happens from now on")
    report = remote(
        "report", "print what happened in the last hours, even of a bridge that has ended", bridge_first=True
    )
    report.set_defaults(command=_report)
    report.add_argument("--last", default="8h", metavar="SPAN", help="8h, 30m, ...; at most 24h (%(default)s)")
    report.add_argument("--csv", action="store_true", help="for a spreadsheet")
    wait = remote("wait", "wait until something is so; exit code 1 if it is not within the time")
    wait.add_argument(
        "--for", dest="wanted", nargs="+", required=True, metavar=("WHAT", "TOPIC"),
        help="flowing TOPIC, linked [CLIENT], or stopped",
    )  # fmt: skip
    wait.add_argument("--timeout", type=float, metavar="N", help="s; default: wait for ever")
    echo = remote(
        "echo", "print a topic's messages, two a second at most, decoded where the type is known", bridge_first=True
    )
    _route(echo)
    echo.add_argument("--once", action="store_true", help="one message")
    echo.add_argument("--count", type=_count, metavar="N", help="so many messages; default: until interrupted")
    echo.add_argument("--timeout", type=float, metavar="N", help="s; exit code 1 if they have not come by then")
    echo.add_argument("--no-arr", dest="arrays", action="store_false", help="leave out the elements of arrays")
    echo.add_argument("--full-length", action="store_true", help="all elements of arrays, not only the first 128")
    remote("stop", "end a running bridge", bridge_first=True)


def add_client_commands(command: AddCommand, complete: Complete) -> None:
    """Add `client` and its own commands; the arguments are those of `add_remote_commands`."""
    parent = command("client", _lazily("list", "client"), "add, remove, list and rekey a server's clients")
    commands = parent.add_subparsers(metavar="COMMAND", required=True)

    def client(name: str, summary: str, *, named: bool = True, hands_out: bool = False) -> argparse.ArgumentParser:
        parser = commands.add_parser(name, help=summary, description=f"{summary}.")
        parser.set_defaults(command=_lazily(name, "client"), saves=name != "show")
        if named:
            parser.add_argument("name", metavar="NAME", help="the client's")
        which = "the server's file; default: that of the bridge that runs here"
        complete(parser.add_argument("session", type=Path, metavar="SESSION", nargs="?", help=which), "yaml_files")
        complete(parser.add_argument("--bridge", metavar="BRIDGE", help="where several bridges run"), "bridge_names")
        parser.add_argument("--control", type=Path, metavar="PATH", help="the bridge's control socket")
        parser.add_argument("--json", action="store_true", help="for programs")
        if hands_out:
            parser.add_argument(
                "--address", default="", metavar="ADDRESS", help="the server's, as the client reaches it"
            )
            output = "for the client's session file; default: standard output"
            parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=output)
        return parser

    add = client("add", "let one more client in: make its key, and print its session file", hands_out=True)
    add.add_argument("--key-file", metavar="PATH", help="its key, made if there is none; default: NAME.key")
    prefix = add.add_mutually_exclusive_group()
    prefix.add_argument("--prefix", dest="use_name", action="store_true", default=None, help="NAME before its topics")
    prefix.add_argument("--no-prefix", dest="use_name", action="store_false", default=None, help="no NAME before them")
    add.add_argument("--allow", action="append", default=[], metavar="PATTERN", help="of topics; may be repeated")
    add.add_argument("--deny", action="append", default=[], metavar="PATTERN", help="of topics; may be repeated")
    client("remove", "let a client in no more; its key file stays")
    client("list", "list the clients, with the fingerprints of their keys", named=False)
    client("rekey", "make a new key for a client, and print its session file", hands_out=True)
    client("show", "print a client's session file again", hands_out=True)


def _lazily(name: str, module: str = "remote") -> Callable[[argparse.Namespace], int]:
    """Import what the command needs only when it is run."""

    def run(arguments: argparse.Namespace) -> int:
        code: int = import_module(f"rsb_console.command.{module}").run(name, arguments)
        return code

    return run


def _report(arguments: argparse.Namespace) -> int:
    code: int = import_module("rsb_console.command.report").run(arguments)
    return code


def _route(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic", metavar="TOPIC", help="its name on the bridge's side")
    parser.add_argument("--link", default="", metavar="CLIENT", help="where several clients have the topic")
    parser.add_argument("--direction", choices=("transmit", "receive"), help="where it goes both ways")


def _count(text: str) -> int:
    """Parse a number of messages.

    Raises:
        ValueError: it is none.
    """
    count = int(text)
    if count < 1:
        raise ValueError
    return count


def _topic_keys(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "keys",
        nargs="*",
        metavar="KEY=VALUE",
        help=f"as in a session file: {TOPIC_KEYS}; an empty value is the default",
    )
