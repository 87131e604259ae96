"""The arguments of the commands on running bridges: of one, of its clients, of calls by hand, and of a fleet."""

from __future__ import annotations

import argparse
import itertools
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

from rsb_bridge.config.file_form import key_of
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_console.command.argument_values import above_0, count, seconds, timeout, window_seconds
from rsb_console.command.ways import ways

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rsb_bridge.model.session import Kind

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
  2  wrong usage: bad arguments, no such topic, or several bridges and no --bridge
  3  no such bridge runs, or it cannot be reached"""
EXIT = f"""\
exit codes:
  0  done
  1  the bridge refused, or did not answer
{NO_BRIDGE}"""
_EXIT_STATUS = f"""\
These are not wrong: a link or a topic that waits for its first connection or
message, a topic that is paused or not armed, a topic without a subscriber, and an
acknowledged fault (`ack`).

exit codes:
  0  nothing is wrong
  1  something is wrong; the output names it
{NO_BRIDGE}"""
_EXIT_ACK = f"""\
An acknowledged fault stays listed, but `status` does not count it as wrong, until
its state or its cause changes.

exit codes:
  0  done
  1  the bridge refused (there is no fault, for example) or did not answer
{NO_BRIDGE}"""
_EXIT_RELOAD = f"""\
exit codes:
  0  everything that differs is changed, or nothing differs
  1  something was not changed; the output names it
{NO_BRIDGE}"""
_EXIT_SAVE = f"""\
Until then, a change lasts as long as the bridge runs. The bridge writes the file, so its
user must be allowed to.

exit codes:
  0  the file holds the running session
  1  not saved: the session has no file, somebody else has changed it, or it cannot be written
{NO_BRIDGE}"""
_EXIT_ARM = f"""\
It stays armed while this command runs. Each line on standard input (Enter) counts as
a key for the deadman time. Ctrl-C disarms it, and so does any other end of this
command.

exit codes:
  1  it could not be armed, or was disarmed otherwise; the message has the reason
{NO_BRIDGE}
  130, 143  it was armed until Ctrl-C, until SIGTERM"""
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
_ADD = f"""\
for example:
  rsb-console add /scan transmit max_rate=5
  rsb-console add /cmd_vel receive qos=reliable
  rsb-console add --service /dock --provider client timeout=120
  rsb-console add --action /navigate_to_pose --provider client
  rsb-console add --parameters /controller_server --provider client

{EXIT}"""
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


def add_remote_commands(
    command: AddCommand, complete: Complete, console_options: Callable[[argparse.ArgumentParser], None]
) -> None:
    """Add the commands.

    Args:
        complete: completes an argument with a function of `rsb_console.command.completion`.
        console_options: adds the options of the console to a parser.
    """

    def remote(name: str, summary: str, more: str = "", *, about_topic: bool = False) -> argparse.ArgumentParser:
        """Add a command for a running bridge, named by ``--bridge`` or, if it takes no other name, by a plain word."""
        parser = command(name, lazily(name, "local_commands" if name == "attach" else "remote"), summary, more or EXIT)
        options = bridge_options if about_topic else named_bridge_options
        options(parser, complete, json=name != "attach")
        return parser

    console_options(remote("attach", "open the console on a bridge that runs already"))
    remote("status", "show how a running bridge, its links and its topics are", _EXIT_STATUS)
    topics = remote("topics", "list the topics and services of a running bridge")
    topics.add_argument(
        "--available", action="store_true", help="list the names that can be bridged, on both sides, instead"
    )
    add = remote("add", "bridge one more topic, service, action or node's parameters", _ADD, about_topic=True)
    name = "its name on this bridge's side, or on the client"
    complete(add.add_argument("topic", metavar="NAME", help=name), "available")
    _kind(add, "kind of the name; default: topic")
    for kind in KINDS[1:]:
        add.add_argument(f"--{kind}", dest="kind", action="store_const", const=kind, help=f"short for --kind {kind}")
    add.add_argument("--provider", choices=("client", "server"), help="for a service: the side whose node answers")
    way = "for a topic: to or from the server, as the client sees it"
    direction = add.add_argument("direction", metavar="transmit|receive", nargs="?", help=way)
    complete(direction, "direction_or_keys")
    _cost_options(add)
    _topic_keys(add, complete)
    which = "the client to bridge with, on a server with several clients"
    complete(add.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    edit = remote("edit", "change a topic or service that is bridged", about_topic=True)
    route_arguments(edit, complete)
    _topic_keys(edit, complete)
    _drop_arm(edit, "with arm=false: also drop the demand that the name requires arming")
    remove = remote("remove", "stop bridging a topic or service, on both sides", about_topic=True)
    route_arguments(remove, complete)
    _drop_arm(remove, "also drop the demand that the name requires arming; otherwise it stays")
    for name, summary in (
        ("pause", "stop carrying a topic's messages or a service's calls, on both sides; all routes of the name"),
        ("resume", "resume a paused topic or service; all routes of the name"),
    ):
        route_arguments(remote(name, summary, about_topic=True), complete)
    ack = remote("ack", "acknowledge a fault, until it changes", _EXIT_ACK, about_topic=True)
    route_arguments(ack, complete, metavar="TOPIC|LINK")
    ack.add_argument("--undo", action="store_true", help="undo the acknowledgement")
    arm = remote("arm", "arm a topic, a service or an action while this command runs", _EXIT_ARM, about_topic=True)
    held = arm.add_mutually_exclusive_group()
    held.add_argument("--ask", action="store_true", help="ask its holder; without an answer it goes over in 10 s")
    held.add_argument("--take", action="store_true", help="take it from its holder at once")
    route_arguments(arm, complete)
    route_arguments(
        remote("disarm", "disarm all routes of a name, also if others armed them", about_topic=True), complete
    )
    retry = remote("retry", "connect now instead of later, and open refused topics again")
    complete(retry.add_argument("--link", default="", metavar="CLIENT", help="the link with this client only"), "links")
    remote("restart", "close the links on both sides and open them again")
    _add_file_commands(remote)
    _add_looking(remote, complete)
    remote("stop", "end a running bridge, and wait until it has ended")


def _add_file_commands(remote: Callable[..., argparse.ArgumentParser]) -> None:
    reload = remote("reload", "read the session file again, and change only what differs", _EXIT_RELOAD)
    reload.add_argument("--dry-run", action="store_true", help="only print what would change")
    _drop_arm(reload, "also drop the demands to arm that the file does not make any more; otherwise they stay")
    remote("save", "save the running session to its file, with the file's comments", _EXIT_SAVE)


def _add_looking(remote: Callable[..., argparse.ArgumentParser], complete: Complete) -> None:
    """Add the commands that print messages, events or figures until an interrupt."""
    events = remote("events", "print the events of a running bridge")
    events.add_argument("--follow", action="store_true", help="continue with new events")
    events.set_defaults(endless=_endless_events)
    wait = remote("wait", "wait until topics flow, a link is up, or the bridge has stopped", _WAIT)
    wanted = wait.add_argument(
        "--for", dest="wanted", nargs="+", required=True, metavar=("WHAT", "NAME"),
        help="flowing TOPIC, linked [CLIENT], or stopped",
    )  # fmt: skip
    complete(wanted, "awaited")
    wait.add_argument("--timeout", type=timeout, metavar="N", help="give up after N s; default: never")
    wait.set_defaults(endless=lambda arguments: _UNTIL.format("wait") if arguments.timeout is None else "")
    echo = remote("echo", "print a topic's messages, two a second at most", _EXIT_ECHO, about_topic=True)
    _echo_arguments(echo, complete)
    for name, summary, more in (
        ("hz", "print a topic's rate, once a second", _EXIT_HZ),
        ("bw", "print a topic's bandwidth and message size, once a second", _EXIT_BW),
    ):
        _figures_arguments(name, remote(name, summary, more, about_topic=True), complete)
    route_arguments(remote("info", "print all details of one topic or service", _EXIT_INFO, about_topic=True), complete)


def _drop_arm(parser: argparse.ArgumentParser, about: str) -> None:
    parser.add_argument("--drop-arm", action="store_true", help=about)


def _echo_arguments(echo: argparse.ArgumentParser, complete: Complete) -> None:
    route_arguments(echo, complete, kinds=("topic",))
    echo.add_argument("--once", action="store_true", help="stop after one message")
    echo.add_argument("--count", type=count, metavar="N", help="stop after N messages; default: until interrupted")
    echo.add_argument("--timeout", type=timeout, metavar="N", help="give up after N s; default: never")
    echo.add_argument("--no-arr", dest="arrays", action="store_false", help="leave out the elements of arrays")
    echo.add_argument("--full-length", action="store_true", help="print all elements of arrays, not only the first 128")
    echo.set_defaults(endless=_endless_echo)


def _endless_events(arguments: argparse.Namespace) -> str:
    return "events --follow does not end: follow one robot's server at a time" if arguments.follow else ""


def _endless_echo(arguments: argparse.Namespace) -> str:
    if not arguments.once and arguments.count is None:
        return "echo does not end: give --once, or --count N"
    return _UNTIL.format("echo") if arguments.timeout is None else ""


def _endless_figures(name: str, arguments: argparse.Namespace) -> str:
    endless = arguments.count is None and arguments.lasts is None
    return f"{name} does not end by itself: give --count N or --for N" if endless else ""


def _figures_arguments(name: str, parser: argparse.ArgumentParser, complete: Complete) -> None:
    route_arguments(parser, complete, kinds=("topic",))
    parser.add_argument("--count", type=count, metavar="N", help="stop after N times; default: until interrupted")
    parser.add_argument("--for", dest="lasts", type=above_0, metavar="N", help="stop after N s; default: never")
    window = "take the figures over the last N s, at most 120 (%(default)s)"
    parser.add_argument("--window", type=window_seconds, default=10, metavar="N", help=window)
    parser.set_defaults(endless=partial(_endless_figures, name))


_UNTIL = "{} may wait for ever: give --timeout N"


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


def named_bridge_options(parser: argparse.ArgumentParser, complete: Complete, *, json: bool = True) -> None:
    """Add the same, and the bridge's name as a plain word, to a command that takes no other one."""
    alone = parser.add_argument(
        "bridge", metavar="NAME", nargs="?", default=argparse.SUPPRESS, help="short for --bridge NAME"
    )
    complete(alone, "bridge_names")
    bridge_options(parser, complete, json=json)


def add_client_commands(command: AddCommand, complete: Complete) -> None:
    """Add `client` and its own commands; for the arguments see `add_remote_commands`."""
    parent = command("client", lazily("list", "client_command"), "add, remove, list and rekey a server's clients")
    commands = parent.add_subparsers(metavar="COMMAND", required=True)

    def client(name: str, summary: str, *, named: bool = True, hands_out: bool = False) -> argparse.ArgumentParser:
        parser = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        parser.set_defaults(command=lazily(name, "client_command"), saves=name != "show")
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


def lazily(name: str, module: str = "remote") -> Callable[[argparse.Namespace], int]:
    """Return a function that imports what the command needs only when it is run, and reports its errors."""

    def run(arguments: argparse.Namespace) -> int:
        from rsb_console.command.target import reported  # noqa: PLC0415 (only once a command runs)

        return reported(import_module(f"rsb_console.command.{module}").COMMANDS[name], arguments)

    return run


def late(place: str) -> Callable[[argparse.Namespace], int]:
    """Return the same of a feature's command, ``package.module:function``."""
    module, function = place.split(":")

    def run(arguments: argparse.Namespace) -> int:
        from rsb_console.command.target import reported  # noqa: PLC0415 (only once a command runs)

        return reported(getattr(import_module(module), function), arguments)

    return run


def route_arguments(
    parser: argparse.ArgumentParser, complete: Complete, kinds: tuple[str, ...] = KINDS, metavar: str = "NAME"
) -> None:
    """Add the arguments that name one bridged topic, service, action or node of these kinds."""
    name = "the name on this bridge's side, or on the client"
    complete(parser.add_argument("topic", metavar=metavar, help=name), "bridged")
    which = "the client, if several have it"
    complete(parser.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    parser.add_argument("--direction", choices=("transmit", "receive"), help="the direction, if it crosses both ways")
    far = "its name on the other side, if several have this name"
    complete(parser.add_argument("--remote", metavar="NAME", help=far), "far_names")
    parser.set_defaults(kinds=kinds, kind=None)
    if len(kinds) > 1:
        _kind(parser, "the kind, if several have this name", kinds)


def _kind(parser: argparse.ArgumentParser, about: str, kinds: tuple[str, ...] = KINDS) -> None:
    parser.add_argument("--kind", choices=kinds, help=about)


def _cost_options(parser: argparse.ArgumentParser) -> None:
    """Add the options about the cost of a topic."""
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="add nothing; print the topic's cost on the link, and which topics would suffer",
    )
    figures = "with --dry-run: its load, if the bridge has no figure"
    parser.add_argument("--rate", type=above_0, metavar="HZ", help=figures)
    parser.add_argument("--size", type=above_0, metavar="BYTES", help=figures)


def _keys(kind: Kind) -> str:
    keys = (key for key in TOPIC_KEYS.values() if key.is_of(kind) and key.name not in ("topic", "direction"))
    return ", ".join(f"{key_of(kind, key.name)}=" for key in keys)


def _topic_keys(parser: argparse.ArgumentParser, complete: Complete) -> None:
    of_calls = _keys("service").replace("remote_service=", "remote_service= (remote_action=, remote_node=)")
    keys = parser.add_argument(
        "keys",
        nargs="*",
        default=[],  # without it argparse calls the argument required
        metavar="KEY=VALUE",
        help=f"as in a session file: {_keys('topic')}; for a service, an action or parameters: {of_calls}; an "
        "empty value means the default",
    )
    complete(keys, "keys")


_CALL = f"""\
The bridge calls it: in this side's domain if the node is there, else over the
link. The type has to be installed where this bridge runs.

for example:
  rsb-console call /dock
  rsb-console call /map_server/load_map '{{map_url: /maps/hall.yaml}}'

to send a goal, wait for its result, or cancel it:
  rsb-console call /navigate_to_pose --lane send_goal '{{goal: {{...}}}}'  # prints its goal_id
  rsb-console call /navigate_to_pose --lane get_result '{{goal_id: ID}}'
  rsb-console call /navigate_to_pose --lane cancel_goal '{{goal_info: {{goal_id: ID}}}}'

exit codes:
  0  the response is printed
  1  no response came, or the bridge refused; the message has the reason
{NO_BRIDGE}"""
_PARAM = f"""\
The parameters of the node have to be bridged: rsb-console add --parameters.

exit codes:
  0  done
  1  the node or the bridge refused or did not answer; the message has the reason
{NO_BRIDGE}"""


def add_call_commands(command: AddCommand, complete: Complete) -> None:
    """Add `call`, and `param` with its own commands; for the arguments see `add_remote_commands`."""
    call = command(
        "call", lazily("call", "call_command"), "call a bridged service once, and print its response as YAML", _CALL
    )
    bridge_options(call, complete)
    route_arguments(call, complete, kinds=KINDS[1:])
    call.add_argument(
        "request", metavar="YAML", nargs="?", default="", help="the request's fields; -: read them from standard input"
    )
    lanes = "for an action: send_goal, cancel_goal, get_result; for parameters: set_parameters, ..."
    complete(call.add_argument("--lane", default="", metavar="SERVICE", help=lanes), "lanes")
    limit = "give up after this time; default: the route's timeout; for get_result, until the goal is over"
    call.add_argument("--timeout", type=seconds, metavar="SECONDS", help=limit)
    parent = command("param", lazily("list", "call_command"), "read and set the parameters of a bridged node", _PARAM)
    commands = parent.add_subparsers(metavar="COMMAND", required=True)
    words: tuple[str, ...]
    for name, summary, words in (
        ("list", "print the names of a node's parameters", ()),
        ("get", "print the value of a parameter", ("parameter",)),
        ("set", "set a parameter", ("parameter", "value")),
        ("dump", "print all parameters of a node as YAML, as ros2 param dump does", ()),
        ("describe", "print a parameter's type, range and description", ("parameter",)),
    ):
        parser = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        parser.set_defaults(command=lazily(name, "call_command"))
        bridge_options(parser, complete)
        route_arguments(parser, complete, kinds=("parameters",), metavar="NODE")
        for word in words:
            argument = parser.add_argument(word, metavar=word.upper())
            if word == "parameter":
                complete(argument, "parameters")
        if name == "set":
            kinds = "type of the value: bool, integer, double, string, byte_array, ...; default: as the value looks"
            complete(parser.add_argument("--type", default="", metavar="TYPE", help=kinds), "parameter_types")


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
    "bw", "info", "wait", "call", "param",
)  # fmt: skip
"""Commands of the core that `exec` runs."""


def add_fleet_commands(
    command: AddCommand, complete: Complete, console_options: Callable[[argparse.ArgumentParser], None]
) -> argparse.ArgumentParser:
    """Add `fleet` and its own commands (arguments as of `add_remote_commands`). Return the parser of `exec`."""
    fleet = command("fleet", lazily("show", "fleet_command"), "show all robots on one screen", _FLEET)
    bridge_options(fleet, complete, which=_WHICH_SERVER, all_bridges=True)
    fleet.add_argument(
        "--seconds",
        type=seconds,
        default=2.0,
        metavar="N",
        help="with --json: observe the loss for N s (2)",
    )
    console_options(fleet)
    commands = fleet.add_subparsers(metavar="COMMAND", parser_class=_FleetParser)
    forget = _add_fleet_command(commands, complete, "dismiss", "forget robots that are gone for good", _DISMISS)
    complete(forget.add_argument("names", metavar="NAME", nargs="*", help="robots"), "robots")
    run = _add_fleet_command(commands, complete, "exec", "run a command for some robots", _EXEC)
    complete(run.add_argument("names", metavar="NAME", nargs="*", help="robots"), "robots")
    run.usage = "rsb-console fleet exec [NAME ...] [--group GROUP] [--all] [--fleet FILE] [--json] -- COMMAND ..."
    edit = _add_fleet_command(commands, complete, "edit", "change a topic of some robots, one after the other", _EDIT)
    words = edit.add_argument(
        "names", metavar="NAME|TOPIC|KEY=VALUE", nargs="*", help="robots, a topic, and its changes"
    )
    complete(words, "robots")
    edit.add_argument("--dry-run", action="store_true", help="only print what would change")
    edit.add_argument("--yes", action="store_true", help="do not ask")
    edit.add_argument("--undo", action="store_true", help="when it stops, restore the previous settings without asking")
    edit.add_argument(
        "--settle", type=seconds, default=10.0, metavar="N", help="seconds that a robot has to stay well (10)"
    )
    return run


def say_what_runs(run: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]) -> None:
    """Have the parser of `fleet exec` know which commands it runs."""
    able = [*_IN_FLEET, *(name for name, each in commands.items() if each.get_default("in_fleet"))]
    run.set_defaults(able=able)
    run.epilog = _EXEC.replace("{commands}", f"{', '.join(able[:8])},\n{', '.join(able[8:])}")


def _add_fleet_command(
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
    parser.set_defaults(command=lazily(name, "fleet_command"))
    bridge_options(parser, complete, which=_WHICH_SERVER, all_bridges=True)
    for option in parser._actions:
        if option.dest in ("bridge", "control", "way", "json"):
            option.default = argparse.SUPPRESS  # `fleet` has them, too, and its values count
    in_group = parser.add_argument("--group", default="", metavar="GROUP", help="also all robots of this group")
    complete(in_group, "groups")
    parser.add_argument("--all", dest="everyone", action="store_true", help="all robots")
    return parser


class CommandParser(argparse.ArgumentParser):
    """Takes options in any place, and shows its own usage when it refuses something."""

    _intermixes = False

    def parse_known_args(  # type: ignore[override]  # argparse's is overloaded, by the kind of namespace
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        args = self._bridge_first(args)
        if self._intermixes:  # argparse calls this for the options, then for the rest
            return super().parse_known_args(args, namespace)
        # argparse refuses to intermix options with the words of subcommands.
        plain = self._subparsers or not {"-h", "--help"}.isdisjoint(
            args or ()
        )  # mixed, the help would leave things out
        parse = super().parse_known_args if plain else self.parse_known_intermixed_args
        self._intermixes = True
        try:
            found, unknown = parse(args, namespace)
        finally:
            self._intermixes = False
        # The main parser would also refuse them, but with its own usage instead of this command's.
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, []

    def _bridge_first(self, args: Sequence[str] | None) -> Sequence[str] | None:
        """Return arguments with ``--bridge`` before a bridge's name that stands first, as in ``pause NAME TOPIC``."""
        if not args or "--bridge" not in self._option_string_actions or args[0].startswith(("-", "/")):
            return args
        return ["--bridge", *args] if self._begins_with_a_bridge(args) else args

    def _begins_with_a_bridge(self, args: Sequence[str]) -> bool:
        """Whether the first word names a bridge: a topic begins with a slash, and a bridge's name does not."""
        words = [word for before, word in itertools.pairwise(("", *args)) if self._is_positional(before, word)]
        own = [action for action in self._actions if not action.option_strings]
        if self._subparsers is not None:  # `fleet NAME`; a command that is mistyped has words of its own
            known = {name for action in own for name in action.choices or ()}
            return words[0] not in known and known.issuperset(words[1:2])
        if {action.dest for action in own}.isdisjoint(("topic", "topics")):
            return False
        # `ack NAME LINK` has no slash that gives the topic away: the number of words decides.
        one_too_many = all(action.nargs is None for action in own) and len(words) == len(own) + 1
        return one_too_many or any(word.startswith(("/", "*")) for word in words[1:])

    def _is_positional(self, before: str, word: str) -> bool:
        option = self._option_string_actions.get(before)
        return not word.startswith("-") and (option is None or option.nargs == 0)


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
