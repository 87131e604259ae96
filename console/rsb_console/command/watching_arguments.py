"""The arguments of the commands that print events, messages and figures of a running bridge."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rsb_console.command.argument_values import above_0, count, timeout, window_seconds
from rsb_console.command.remote_arguments import NO_BRIDGE, bridge_command, route_command

if TYPE_CHECKING:
    import argparse

    from rsb_console.command.remote_arguments import AddCommand, Complete

_EXIT_ECHO = f"""\
Messages are decoded if one of the sides has the type.

exit codes:
  0  the messages are printed
  1  the messages did not come in time
{NO_BRIDGE}"""
_EXIT_FIGURES = f"""\
The bridge's own figures, {{where}}.

exit codes:
  0  the figures are printed
  1  no message came while they were taken
{NO_BRIDGE}
  130  interrupted by Ctrl-C"""
_EXIT_HZ = _EXIT_FIGURES.format(
    where="counted where it gives messages to the link's queue, or\npublishes the messages of the other side"
)
_EXIT_BW = _EXIT_FIGURES.format(where="of payload before compression, as for hz")
_EXIT_INFO = f"""\
exit codes:
  0  printed, even if the topic or service has a fault
  1  the bridge did not answer
{NO_BRIDGE}"""
_WAIT = f"""\
  flowing TOPIC     messages of the topic cross, over every link that has it; of
                    a service, an action or a node's parameters: it can be called
  linked [CLIENT]   the link is up; without CLIENT: any link
  stopped           the bridge has ended

A topic that a client does not bridge, and a client that a server does not know,
are wrong usage: the wait could never end. A server waits for a topic that it does
not know yet, because a client may add it.

for example:
  rsb-console wait --for flowing /scan --timeout 10 && ros2 launch ...

exit codes:
  0  the condition is true
  1  the condition did not become true in time
{NO_BRIDGE}"""
_UNTIL = "{} may wait for ever: give --timeout N"


def add_watching_commands(command: AddCommand, complete: Complete) -> None:
    remote = partial(bridge_command, command, complete)
    events = remote("events", "watching_commands:print_events", "print the events of a running bridge", after="save")
    events.add_argument("--follow", action="store_true", help="continue with new events")
    endless = "events --follow does not end: follow one robot's server at a time"
    events.set_defaults(endless=lambda arguments: endless if arguments.follow else "")
    summary = "wait until topics flow, a link is up, or the bridge has stopped"
    wait = remote("wait", "watching_commands:wait_until", summary, _WAIT, after="events")
    wanted = wait.add_argument(
        "--for", dest="wanted", nargs="+", required=True, metavar=("WHAT", "NAME"),
        help="flowing TOPIC, linked [CLIENT], or stopped",
    )  # fmt: skip
    complete(wanted, "awaited")
    wait.add_argument("--timeout", type=timeout, metavar="N", help="give up after N s; default: never")
    wait.set_defaults(endless=lambda arguments: _UNTIL.format("wait") if arguments.timeout is None else "")
    of_route = partial(route_command, command, complete)
    summary = "print a topic's messages, two a second at most"
    _echo_arguments(
        of_route("echo", "watching_commands:print_messages", summary, _EXIT_ECHO, after="wait", kinds=("topic",))
    )
    for after, name, summary, more in (
        ("echo", "hz", "print a topic's rate, once a second", _EXIT_HZ),
        ("hz", "bw", "print a topic's bandwidth and message size, once a second", _EXIT_BW),
    ):
        _figures_arguments(name, of_route(name, f"figures:{name}", summary, more, after=after, kinds=("topic",)))
    of_route("info", "info:print_info", "print all details of one topic or service", _EXIT_INFO, after="bw")


def _echo_arguments(echo: argparse.ArgumentParser) -> None:
    echo.add_argument("--once", action="store_true", help="stop after one message")
    echo.add_argument("--count", type=count, metavar="N", help="stop after N messages; default: until interrupted")
    echo.add_argument("--timeout", type=timeout, metavar="N", help="give up after N s; default: never")
    echo.add_argument("--no-arr", dest="arrays", action="store_false", help="leave out the elements of arrays")
    echo.add_argument("--full-length", action="store_true", help="print all elements of arrays, not only the first 128")
    echo.set_defaults(endless=_endless_echo)


def _figures_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=count, metavar="N", help="stop after N times; default: until interrupted")
    parser.add_argument("--for", dest="lasts", type=above_0, metavar="N", help="stop after N s; default: never")
    window = "take the figures over the last N s, at most 120 (%(default)s)"
    parser.add_argument("--window", type=window_seconds, default=10, metavar="N", help=window)
    parser.set_defaults(endless=partial(_endless_figures, name))


# What `fleet exec` says of commands that do not end by themselves.


def _endless_echo(arguments: argparse.Namespace) -> str:
    if not arguments.once and arguments.count is None:
        return "echo does not end: give --once, or --count N"
    return _UNTIL.format("echo") if arguments.timeout is None else ""


def _endless_figures(name: str, arguments: argparse.Namespace) -> str:
    endless = arguments.count is None and arguments.lasts is None
    return f"{name} does not end by itself: give --count N or --for N" if endless else ""
