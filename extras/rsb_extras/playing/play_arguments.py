"""The arguments of the commands ``play`` and ``review``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.model.limits import DOMAIN
from rsb_console.feature_console import subcommand, topic_pattern, within

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_PLAY = """\
FILE is *.mcap or *.db3, or a folder of rosbag2. Types need not be installed.
What may move a robot is left out, unless --arm is given and answered with yes.

at a terminal:
  space  pause, go on     .  one message (while it pauses)
  left, right  5 s        down, up  60 s         q, Ctrl-C  end

for example:
  rsb-console play bag --domain 5
  rsb-console play stretch.mcap --domain 5 --topics '/camera/**' /tf --rate 0.5
  rsb-console play bag --domain 5 --from 60 --to 90 --loop --clock

exit codes:
  0  played to the end, or ended by q
  1  nothing could be played, or the file is damaged
  2  wrong usage, or a file that cannot be read
  130  interrupted by Ctrl-C"""

_REVIEW = """\
The screen lists the topics, and shows what the chosen one has at the chosen time:
its picture, drawn as `look` does, and its message. It needs no bridge and no ROS
graph, and publishes nothing.

for example:
  rsb-console review bag
  rsb-console review stretch.mcap /camera/image_raw --at 42.5

exit codes:
  0  left
  2  wrong usage, no terminal, or a file that cannot be read"""


_CLOCK_RATE = 40.0  # Hz, as `ros2 bag play` has it


def add_play(add: AddCommand, complete: Complete) -> None:
    run = subcommand("rsb_extras.playing.play_command:play")
    parser = add("play", run, "publish the messages of a recording in a ROS domain", _PLAY, after="audit")
    complete(parser.add_argument("file", type=Path, metavar="FILE", help="the recording"), "files")
    parser.add_argument("--domain", type=domain_id, required=True, metavar="N", help="ROS domain to publish in")
    only = "play only these topics"
    parser.add_argument("--topics", type=topic_pattern, nargs="+", default=[], metavar="PATTERN", help=only)
    speed = "how many times as fast as it was recorded (%(default)g)"
    parser.add_argument("--rate", type=within(0.01, 1000), default=1.0, metavar="N", help=speed)
    for name, until in (("from", "play from there on, in seconds from its begin"), ("to", "play up to there")):
        parser.add_argument(f"--{name}", dest=f"at_{name}", type=within(0, 1e9), metavar="SECONDS", help=until)
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    clock = "publish the recording's time on /clock, HZ times a second (40)"
    parser.add_argument("--clock", type=within(1, 1000), nargs="?", const=_CLOCK_RATE, metavar="HZ", help=clock)
    settle = "time for nodes to find the publishers, before the first message (%(default)g)"
    parser.add_argument("--delay", type=within(0, 3600), default=1.0, metavar="SECONDS", help=settle)
    parser.add_argument("--paused", action="store_true", help="wait for a space before the first message")
    arm = "play also what may move a robot; asks first, at a terminal"
    parser.add_argument("--arm", action="store_true", help=arm)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, for programs")


def domain_id(text: str) -> int:
    """Parse the id of a ROS domain.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    if text.isascii() and text.isdigit() and (found := int(text[:4])) in DOMAIN:
        return found
    raise argparse.ArgumentTypeError(f"{text!r} is not a ROS domain: {DOMAIN}")


def add_review(add: AddCommand, complete: Complete) -> None:
    run = subcommand("rsb_extras.playing.review_command:review")
    parser = add("review", run, "look at a recording: topics, pictures, messages", _REVIEW, after="play")
    complete(parser.add_argument("file", type=Path, metavar="FILE", help="*.mcap, *.db3, or a rosbag2 folder"), "files")
    parser.add_argument("topic", nargs="?", default="", metavar="TOPIC", help="to begin with; default: the first one")
    place = "where to begin, in seconds from its begin"
    parser.add_argument("--at", type=within(0, 1e9), metavar="SECONDS", help=place)
    parser.add_argument("--ascii", action="store_true", help="draw with ASCII characters")
    parser.add_argument("--no-mouse", action="store_true", help="leave the mouse to the terminal")
    complete(parser.add_argument("--theme", metavar="NAME", help="theme to start with"), "theme_names")
