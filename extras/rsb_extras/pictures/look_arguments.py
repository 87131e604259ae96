"""The arguments of the command ``look``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.command.argument_values import timeout
from rsb_console.feature_console import NO_BRIDGE, bridge_options, count, subcommand, within

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

_MORE = f"""\
The side that publishes the topic draws it, so that only the picture crosses the
link, also of a topic that is not bridged. Ctrl-C ends.

for example:
  rsb-console look /camera/image_raw
  rsb-console look /map /scan /tf --as map
  rsb-console look /odom --as plot --field twist.twist.linear.x
  rsb-console look /camera/image_raw --output picture.png

exit codes:
  0  drawn
  1  no picture came, or the other side refused
{NO_BRIDGE}
  130  interrupted by Ctrl-C"""


def add_look(add: AddCommand, complete: Complete) -> None:
    summary = "draw a topic's messages as pictures, images included"
    look = add("look", subcommand("rsb_extras.pictures.look_command:look"), summary, _MORE, after="echo")
    bridge_options(look, complete)
    topics = "name on this side, or on the other one; the further ones are laid over a map"
    complete(look.add_argument("topics", nargs="+", metavar="TOPIC", help=topics), "available")
    link = "the link to the side that publishes it, if several do"
    complete(look.add_argument("--link", default="", metavar="CLIENT", help=link), "links")
    look.add_argument("--once", action="store_true", help="print one picture, as without a terminal")
    look.add_argument("--timeout", type=timeout, metavar="N", help="with --once: give up after N s; default: 60")
    look.add_argument("--output", type=Path, metavar="FILE", help="write one picture to FILE: .png, .svg, .txt or .csv")
    look.add_argument("--as", dest="how", choices=("plot", "tree", "map"), default="", help="default: by the type")
    look.add_argument("--field", action="append", default=[], metavar="PATH", help="number to plot: pose.position.x")
    look.add_argument(
        "--seconds", type=within(1, 3600), default=30.0, metavar="N", help="length of a plot (%(default)g)"
    )
    look.add_argument(
        "--rate", type=within(0.05, 10), default=2.0, metavar="HZ", help="pictures a second, at most 10 (%(default)g)"
    )
    look.add_argument(
        "--zoom", type=within(0.01, 1000), default=1.0, metavar="N", help="show less, larger (%(default)g)"
    )
    look.add_argument(
        "--tilt", type=within(0, 90), default=0.0, metavar="DEGREES", help="see points from the side, up to 90"
    )
    look.add_argument("--colour", choices=("height", "intensity"), default="height", help="colour of points")
    look.add_argument("--frame", default="", metavar="FRAME", help="frame of a map")
    look.add_argument("--match", default="", metavar="TEXT", help="show only lines that contain TEXT")
    look.add_argument("--width", type=count, metavar="N", help="cells; default: the terminal's")
    look.add_argument("--height", type=count, metavar="N", help="cells; default: the terminal's")
    way = "how to show images: kitty or sixel (terminals that show pixels), or blocks; default: ask the terminal"
    look.add_argument("--graphics", choices=("auto", "kitty", "sixel", "blocks"), default="auto", help=way)
    finer = "pixels of an image across a character, 1 to 16; default: 6, and with --output the image's own"
    look.add_argument("--detail", type=int, choices=range(1, 17), metavar="N", help=finer)
    look.add_argument("--ascii", action="store_true", help="use neither colours nor block characters")
    look.set_defaults(kind="topic")
