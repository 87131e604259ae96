"""The arguments of ``rsb-console audit``. argparse prints an option's name before the message of what parses it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.model.names import is_topic_name
from rsb_console.feature_console import seconds, subcommand, topic_pattern

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_AUDIT = """\
NEAR and FAR are recordings of the same time, one of each ROS domain, of any bridge:
files *.mcap or *.db3, or folders of rosbag2. Messages are matched by their content.

for example:
  rsb-console audit near.mcap far.mcap
  rsb-console audit near_bag far_bag --back /cmd_vel --topic '/camera/**'
  rsb-console audit near.mcap far.mcap --pair /scan=/robots/r1/scan --json

exit codes:
  0  all that QoS promises has crossed, as far as the recordings show
  1  something is lost, doubled, reordered, old, unanswered or has not crossed; both
     sides have a topic, and no message of it is the same; where messages should
     arrive, nothing is recorded for over 10 s at an end; or the recordings have
     nothing in common
  2  the recordings cannot be compared: wrong usage, or a file that cannot be read"""


def add_audit_command(command: AddCommand, complete: Complete) -> None:
    run = subcommand("rsb_extras.audit.audit_command:audit")
    parser = command("audit", run, "compare a recording of each side of a bridge", _AUDIT, after="record")
    for side, which in (("near", "the recording where messages come from"), ("far", "the one where they arrive")):
        complete(parser.add_argument(side, type=Path, metavar=side.upper(), help=which), "files")
    only = "judge only these topics, which have to cross; may be repeated"
    parser.add_argument("--topic", type=topic_pattern, action="append", default=[], metavar="PATTERN", help=only)
    names = "topics that belong together; may be repeated. Default: the same name, or one with a prefix"
    parser.add_argument("--pair", type=names_of_pair, action="append", default=[], metavar="NEAR=FAR", help=names)
    for name, ends in (("back", "FAR to NEAR"), ("forth", "NEAR to FAR")):
        which = f"topics that go from {ends}; may be repeated. Default: found from the messages"
        parser.add_argument(f"--{name}", type=topic_pattern, action="append", default=[], metavar="PATTERN", help=which)
    ahead = "FAR's clock is ahead by so much; default: found from the messages"
    parser.add_argument("--offset", type=offset, metavar="SECONDS", help=ahead)
    silence = "list silences longer than this, of topics that usually have none (%(default)g)"
    parser.add_argument("--gap", type=seconds, default=1.0, metavar="SECONDS", help=silence)
    shorter = "one recording may be shorter: judge only the time of both"
    parser.add_argument("--overlap", action="store_true", help=shorter)
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def names_of_pair(text: str) -> tuple[str, str]:
    """Parse names of topics that belong together: ``/scan=/robot1/scan``.

    Raises:
        argparse.ArgumentTypeError: they are not two topics' names.
    """
    near, _, far = text.partition("=")
    if not (is_topic_name(near) and is_topic_name(far)):
        raise argparse.ArgumentTypeError(f"{text!r} is not two topics' names, such as /scan=/robot1/scan")
    return near, far


def offset(text: str) -> float:
    """Parse a difference of clocks.

    Raises:
        argparse.ArgumentTypeError: it is not a number of seconds up to 4e9.
    """
    try:
        parsed = float(text)
    except ValueError:
        parsed = float("nan")
    if not abs(parsed) <= _MOST_OFFSET:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds up to {_MOST_OFFSET:g}")
    return parsed


_MOST_OFFSET = 4e9  # s: a clock without a battery that says 1970, and more
