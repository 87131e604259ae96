"""Parsers for the values of options. argparse prints the option's name before their messages."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, get_args

from rsb_bridge.model.transports import Protocol
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable

_REMEMBERED = 120  # seconds that the engine keeps counts of: `telemetry.meters.HISTORY`
TRANSPORTS = get_args(Protocol)
_UNITS = {"": 1, "b": 1, "k": 1_000, "kb": 1_000, "m": 1_000_000, "mb": 1_000_000}
_LEAST, _MOST = 64, 16_000_000  # bytes; a stamp needs 20 (`cdr.known_types`), a bridge takes 16 MiB (`model.benchmark`)
_MOST_DOMAIN = 101  # from 102 on, Linux gives a domain's ports to other programs
_MOST_TOPICS = 500  # as many as were ever measured: bench/README.md, Opening 500 topics


class ValueProblem(Wording):
    """Reasons why an option's value is refused."""

    NOT_ABOVE_0 = "{text!r} is not a {noun} above 0"


def seconds(text: str) -> float:
    """Parse a time.

    Raises:
        argparse.ArgumentTypeError: it is not a number above 0.
    """
    return above_0(text, "number of seconds")


def above_0(text: str, noun: str = "number") -> float:
    """Parse a figure, whose `noun` is for the message.

    Raises:
        argparse.ArgumentTypeError: it is not a number above 0.
    """
    parsed = _number(text)
    if not 0 < parsed < float("inf"):
        raise argparse.ArgumentTypeError(ValueProblem.NOT_ABOVE_0(text=text, noun=noun))
    return parsed


def within(least: float, most: float) -> Callable[[str], float]:
    """Return a parser of numbers in a range, ends included."""

    def parse(text: str) -> float:
        parsed = _number(text)
        if not least <= parsed <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number from {least:g} to {most:g}")
        return parsed

    return parse


def timeout(text: str) -> float:
    """Parse a timeout; 0 means a single check.

    Raises:
        argparse.ArgumentTypeError: it is not a number from 0 on.
    """
    parsed = _number(text)
    # `Future.result` raises an OverflowError for infinity.
    if not 0 <= parsed < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds, 0 or more")
    return parsed


def count(text: str) -> int:
    """Parse a number of messages.

    Raises:
        argparse.ArgumentTypeError: it is not a whole number above 0.
    """
    try:
        parsed = int(text)
    except ValueError:
        parsed = 0
    if parsed < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return parsed


def window_seconds(text: str) -> int:
    """Parse a time span for which the engine keeps counts of each second.

    Raises:
        argparse.ArgumentTypeError: it is not a whole number from 1 to 120.
    """
    # `isdigit` takes ², too, which `int` refuses, as it refuses more than 4,300 digits.
    if not (text.isascii() and text.isdigit()) or not 1 <= int(text[:4]) <= _REMEMBERED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of seconds from 1 to {_REMEMBERED}")
    return int(text)


def _number(text: str) -> float:
    """Parse a number; invalid text becomes NaN, which is outside every range."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


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
