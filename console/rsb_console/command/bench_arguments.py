"""The arguments of the command `bench`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from rsb_bridge.model.session import Protocol
from rsb_console.command.remote_arguments import lazily, place_options
from rsb_console.command.values import seconds

if TYPE_CHECKING:
    from rsb_console.command.remote_arguments import AddCommand, Complete

TRANSPORTS = get_args(Protocol)
_UNITS = {"": 1, "b": 1, "k": 1_000, "kb": 1_000, "m": 1_000_000, "mb": 1_000_000}
_LEAST, _MOST = 64, 16_000_000
_MOST_DOMAIN = 101
_MOST_TOPICS = 500
_MORE = """\
Without NAME: two bridges between two ROS domains on this machine, over loopback.
With the name or the file of a session that a bridge here runs: its link with the
peer, whose operator has to give leave (bench: {} in the peer's session file).

for example:
  rsb-console bench --quick
  rsb-console bench robot1 --sizes 2500,1M --plot link.svg
  rsb-console bench control --link robot1 --direction both --json

exit codes:
  0  measured; also if time, or the peer's leave, did not suffice for everything
  1  nothing could be measured: why is said
  2  wrong usage: bad arguments, or several bridges or clients to choose from
  3  no such bridge runs, or it cannot be reached
  130, 143  interrupted; what was measured until then is printed"""


def add_bench_command(command: AddCommand, complete: Complete) -> None:
    """Add `bench`; the arguments are those of `rsb_console.command.remote_arguments.add_remote_commands`."""
    parser = command("bench", lazily("bench", "bench"), "measure what this machine, or a link, carries", _MORE)
    name = parser.add_argument("bridge", metavar="NAME", nargs="?", help="a running bridge, or its session file")
    complete(name, "bridges_and_files")
    place_options(parser, complete)
    which = "on a server of several clients: which one"
    complete(parser.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    parser.add_argument("--quick", action="store_true", help="at most a minute; else up to six")
    parser.add_argument("--seconds", type=seconds, metavar="N", help="at most N s; default: 50 with --quick, else 360")
    parser.add_argument("--sizes", type=sizes, metavar="N,...", help="of the messages: 256,10k,1M; default: 256 to 6M")
    which = f"of {', '.join(TRANSPORTS)}; default: all that there are"
    parser.add_argument("--transports", type=transports, default=(), metavar="NAME,...", help=which)
    way = "to the server, from it, or both (%(default)s)"
    parser.add_argument("--direction", choices=("transmit", "receive", "both"), default="transmit", help=way)
    numbers = "how many topics to open at once on this machine: 1,50,500; 0: skip that"
    parser.add_argument("--topics", type=topics, metavar="N,...", help=numbers)
    own = "two ROS domains on this machine that nobody uses (92,93)"
    parser.add_argument("--domains", type=domains, metavar="A,B", help=own)
    parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="draw it, too")
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def sizes(text: str) -> tuple[int, ...]:
    """Parse sizes: ``256,10k,1M``.

    Raises:
        argparse.ArgumentTypeError: one is none.
    """
    return tuple(dict.fromkeys(_size(part) for part in text.split(",")))


def _size(part: str) -> int:
    digits = part.strip().rstrip("bBkKmM")
    unit = part.strip()[len(digits) :].lower()
    try:
        size = round(float(digits) * _UNITS[unit])
    except (ValueError, KeyError, OverflowError):
        size = 0
    if not _LEAST <= size <= _MOST:
        raise argparse.ArgumentTypeError(f"{part!r} is not a size from {_LEAST} bytes to 16M, such as 2500, 10k or 1M")
    return size


def transports(text: str) -> tuple[str, ...]:
    """Parse transports: ``tcp,udp``.

    Raises:
        argparse.ArgumentTypeError: one is none.
    """
    named = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",")))
    for name in named:
        if name not in TRANSPORTS:
            raise argparse.ArgumentTypeError(f"{name!r} is not one of {', '.join(TRANSPORTS)}")
    return named


def topics(text: str) -> tuple[int, ...]:
    """Parse numbers of topics; ``0`` is none.

    Raises:
        argparse.ArgumentTypeError: one is none.
    """
    numbers = _numbers(text)
    if numbers == (0,):
        return ()
    if not numbers or not all(1 <= number <= _MOST_TOPICS for number in numbers):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers from 1 to {_MOST_TOPICS}, or 0")
    return numbers


def domains(text: str) -> tuple[int, int]:
    """Parse two ROS domains: ``92,93``.

    Raises:
        argparse.ArgumentTypeError: they are none, or the same.
    """
    found = _numbers(text)
    if len(found) != 2 or found[0] == found[1] or not all(0 <= each <= _MOST_DOMAIN for each in found):
        raise argparse.ArgumentTypeError(f"{text!r} is not two different ROS domains from 0 to {_MOST_DOMAIN}")
    return found[0], found[1]


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        return ()
