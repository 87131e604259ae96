"""The arguments of the command ``pub``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import NO_BRIDGE, bridge_options, count, subcommand, within

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
The bridge publishes on its side, as a node would, and its routes take the message to
the other side. The type has to be installed where this bridge runs. A topic that has
to be armed takes messages only while it is armed. Missing fields have their defaults;
a time may be now, a header auto.

for example:
  rsb-console pub /goal_pose --template > goal.yaml
  rsb-console pub /goal_pose - < goal.yaml
  rsb-console pub /cmd_vel '{{linear: {{x: 0.2}}}}' --rate 10
  rsb-console pub /words 'data: hello' --type std_msgs/msg/String

exit codes:
  0  published, and taken by a subscription here or by a link
  1  refused, or nobody gets it
{NO_BRIDGE}
  130  interrupted by Ctrl-C"""


def add_pub(add: AddCommand, complete: Complete) -> None:
    pub = add("pub", subcommand("rsb_extras.driving.pub_command:pub"), "publish messages by hand", _MORE, after="echo")
    bridge_options(pub, complete)
    complete(pub.add_argument("topic", metavar="TOPIC", help="its name on this bridge's side"), "available")
    pub.add_argument(
        "message", nargs="?", metavar="YAML", help="fields of the message; - reads them from standard input"
    )
    pub.add_argument("--template", action="store_true", help="print a message to begin with, and publish nothing")
    pub.add_argument("--type", default="", metavar="TYPE", help="type of a topic that nobody has yet")
    pub.add_argument("--rate", type=within(0.01, 100), metavar="HZ", help="repeat, at most 100 times a second")
    pub.add_argument(
        "--count", type=count, metavar="N", help="stop after N messages; default: with --rate never, else 1"
    )
    pub.set_defaults(kind="topic", in_fleet=True, endless=_endless)


def _endless(arguments: Namespace) -> str:
    endless = arguments.rate is not None and arguments.count is None
    return "pub --rate does not end by itself: give --count N" if endless else ""
