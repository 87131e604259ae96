"""The arguments of ``rsb-console bench``. argparse prints an option's name before the message of what parses it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from rsb_bridge.model.transports import Protocol
from rsb_console.command.remote_arguments import place_options
from rsb_console.feature_console import seconds, subcommand

if TYPE_CHECKING:
    from rsb_console.feature_console import AddCommand, Complete

TRANSPORTS = get_args(Protocol)
_UNITS = {"": 1, "b": 1, "k": 1_000, "kb": 1_000, "m": 1_000_000, "mb": 1_000_000}
_LEAST, _MOST = 64, 16_000_000  # bytes; a stamp needs 24 (`cdr.known_types`), a bridge takes 16 MiB (`benchmark`)
_MOST_DOMAIN = 101  # from 102 on, Linux gives a domain's ports to other programs
_MOST_TOPICS = 500  # as many as were ever measured: bench/README.md, Opening 500 topics
_BENCH = """\
Without NAME: two bridges between two ROS domains on this machine, over loopback.
With the name or the session file of a bridge that runs here: its link to the peer.
The peer's session file has to permit it (bench: {}).

for example:
  rsb-console bench --quick
  rsb-console bench robot1 --sizes 2500,1M --plot link.svg
  rsb-console bench control --link robot1 --direction both --json

exit codes:
  0  measured, if only in part because time or the peer's limits ran out
  1  nothing could be measured; the message has the reason
  2  wrong usage: bad arguments, or several bridges or clients to choose from
  3  no such bridge runs, or it cannot be reached
  130, 143  interrupted; the results so far are printed"""


def add_bench_command(command: AddCommand, complete: Complete) -> None:
    run = subcommand("rsb_extras.bench.bench_command:bench")
    parser = command("bench", run, "measure what this machine, or a link, carries", _BENCH, after="client")
    which = "a running bridge, or its session file"
    # Without SUPPRESS, the default of the missing word would overwrite --bridge.
    name = parser.add_argument("bridge", metavar="NAME", nargs="?", default=argparse.SUPPRESS, help=which)
    complete(name, "bridges_and_files")
    complete(parser.add_argument("--bridge", metavar="NAME", help="the same"), "bridges_and_files")
    place_options(parser, complete)
    which = "the client, on a server with several clients"
    complete(parser.add_argument("--link", default="", metavar="CLIENT", help=which), "links")
    parser.add_argument("--quick", action="store_true", help="take at most a minute, not six")
    parser.add_argument(
        "--seconds", type=seconds, metavar="N", help="take at most N s; default: 50 with --quick, else 360"
    )
    parser.add_argument("--sizes", type=sizes, metavar="N,...", help="message sizes: 256,10k,1M; default: 256 to 6M")
    which = f"any of {', '.join(TRANSPORTS)}; default: all available ones"
    parser.add_argument("--transports", type=transports, default=(), metavar="NAME,...", help=which)
    way = "to the server, from it, or both (%(default)s)"
    parser.add_argument("--direction", choices=("transmit", "receive", "both"), default="transmit", help=way)
    numbers = "numbers of topics to open at once on this machine: 1,50,500; 0 skips this part"
    parser.add_argument("--topics", type=topics, metavar="N,...", help=numbers)
    own = "two unused ROS domains on this machine (92,93)"
    parser.add_argument("--domains", type=domains, metavar="A,B", help=own)
    parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="also draw a plot")
    both = "on this machine: also write the messages of all runs, to FILE-near.mcap and FILE-far.mcap"
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help=both)
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def sizes(text: str) -> tuple[int, ...]:
    """Parse sizes: ``256,10k,1M``.

    Raises:
        argparse.ArgumentTypeError: one is none.
    """
    # `256,256b` is one size, which would be measured twice.
    return tuple(dict.fromkeys(_size(part) for part in text.split(",")))


def _size(part: str) -> int:
    digits = part.strip().rstrip("bBkKmM")
    unit = part.strip()[len(digits) :].lower()
    try:
        size = round(float(digits) * _UNITS[unit])
    except (ValueError, KeyError, OverflowError):  # 1e999 is infinite, which `round` does not take
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
    """Parse numbers of topics; ``0`` means no measurement.

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
