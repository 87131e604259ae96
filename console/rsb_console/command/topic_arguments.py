"""The arguments of the commands that list and change what a running bridge carries."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.config.file_form import key_of
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_console.command.argument_values import above_0
from rsb_console.command.remote_arguments import (
    EXIT,
    KINDS,
    NO_BRIDGE,
    bridge_command,
    bridge_options,
    drop_arm_option,
    kind_option,
    route_arguments,
    route_command,
    subcommand,
)

if TYPE_CHECKING:
    import argparse

    from rsb_bridge.model.session import Kind
    from rsb_console.command.remote_arguments import AddCommand, Complete

_EXIT_ACK = f"""\
An acknowledged fault stays listed, but `status` does not count it as wrong, until
its state or its cause changes.

exit codes:
  0  done
  1  the bridge refused (there is no fault, for example) or did not answer
{NO_BRIDGE}"""
_EXIT_ARM = f"""\
It stays armed while this command runs. Each line on standard input (Enter) counts as
a key for the deadman time. Ctrl-C disarms it, and so does any other end of this
command.

exit codes:
  1  it could not be armed, or was disarmed otherwise; the message has the reason
{NO_BRIDGE}
  130, 143  it was armed until Ctrl-C, until SIGTERM"""
_ADD = f"""\
for example:
  rsb-console add /scan transmit max_rate=5
  rsb-console add /cmd_vel receive qos=reliable
  rsb-console add --service /dock --provider client timeout=120
  rsb-console add --action /navigate_to_pose --provider client
  rsb-console add --parameters /controller_server --provider client

{EXIT}"""


def add_topic_commands(command: AddCommand, complete: Complete) -> None:
    summary = "list the topics and services of a running bridge"
    topics = bridge_command(command, complete, "topics", "route_commands:print_topics", summary, after="status")
    available = "list the names that can be bridged, on both sides, instead"
    topics.add_argument("--available", action="store_true", help=available)
    summary = "bridge one more topic, service, action or node's parameters"
    add = command("add", subcommand("route_commands:add_topic"), summary, _ADD, "topics")
    bridge_options(add, complete)
    name = "its name on this bridge's side, or on the client"
    complete(add.add_argument("topic", metavar="NAME", help=name), "available")
    kind_option(add, "kind of the name; default: topic")
    for kind in KINDS[1:]:
        add.add_argument(f"--{kind}", dest="kind", action="store_const", const=kind, help=f"short for --kind {kind}")
    add.add_argument("--provider", choices=("client", "server"), help="for a service: the side whose node answers")
    way = "for a topic: to or from the server, as the client sees it"
    direction = add.add_argument("direction", metavar="transmit|receive", nargs="?", help=way)
    complete(direction, "direction_or_keys")
    cost = "add nothing; print the topic's cost on the link, and which topics would suffer"
    add.add_argument("--dry-run", action="store_true", help=cost)
    figures = "with --dry-run: its load, if the bridge has no figure"
    add.add_argument("--rate", type=above_0, metavar="HZ", help=figures)
    add.add_argument("--size", type=above_0, metavar="BYTES", help=figures)
    _topic_keys(add, complete)
    which = "the client to bridge with, on a server with several clients"
    complete(add.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    of_route = partial(route_command, command, complete)
    edit = of_route("edit", "route_commands:edit_topic", "change a topic or service that is bridged", after="add")
    _topic_keys(edit, complete)
    drop_arm_option(edit, "with arm=false: also drop the demand that the name requires arming")
    summary = "stop bridging a topic or service, on both sides"
    remove = of_route("remove", "route_commands:remove_topic", summary, after="edit")
    demand = remove.add_mutually_exclusive_group()
    demand.add_argument("--drop-arm", action="store_true", help="also drop the demand that the name requires arming")
    keep = "keep that demand; without either option, the command asks about an entry with arm"
    demand.add_argument("--keep-arm", dest="drop_arm", action="store_false", help=keep)
    remove.set_defaults(drop_arm=None)
    summary = "stop carrying a topic's messages or a service's calls, on both sides; all routes of the name"
    of_route("pause", "route_commands:pause_topic", summary, after="remove")
    summary = "resume a paused topic or service; all routes of the name"
    of_route("resume", "route_commands:resume_topic", summary, after="pause")
    summary = "acknowledge a fault, until it changes"
    ack = of_route("ack", "route_commands:acknowledge", summary, _EXIT_ACK, after="resume", metavar="TOPIC|LINK")
    ack.add_argument("--undo", action="store_true", help="undo the acknowledgement")
    summary = "arm a topic, a service or an action while this command runs"
    arm = command("arm", subcommand("arming_commands:arm_topic"), summary, _EXIT_ARM, "ack")
    bridge_options(arm, complete)
    held = arm.add_mutually_exclusive_group()
    held.add_argument("--ask", action="store_true", help="ask its holder; without an answer it goes over in 10 s")
    held.add_argument("--take", action="store_true", help="take it from its holder at once")
    route_arguments(arm, complete)
    summary = "disarm all routes of a name, also if others armed them"
    of_route("disarm", "arming_commands:disarm_topic", summary, after="arm")


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
