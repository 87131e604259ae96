"""Parsers for the values of options. They raise argparse.ArgumentTypeError; argparse prints the option's name first."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rsb_bridge.model.patterns import Pattern, is_valid
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable

_REMEMBERED = 120  # seconds that the engine keeps counts of: `telemetry.meters.HISTORY`


class ValueProblem(Wording):
    """Reasons why an option's value is refused."""

    NOT_ABOVE_0 = "{text!r} is not a {noun} above 0"


def seconds(text: str) -> float:
    return above_0(text, "number of seconds")


def above_0(text: str, noun: str = "number") -> float:
    """Parse a number above 0, whose `noun` is for the message."""
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
    """Parse a timeout (s); 0 means a single check."""
    parsed = _number(text)
    # `Future.result` raises an OverflowError for infinity.
    if not 0 <= parsed < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds, 0 or more")
    return parsed


def count(text: str) -> int:
    """Parse a number of messages, at least one."""
    try:
        parsed = int(text)
    except ValueError:
        parsed = 0
    if parsed < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return parsed


def window_seconds(text: str) -> int:
    """Parse a time span (s) for which the engine keeps counts of each second: 1 to 120."""
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


def topic_pattern(text: str) -> Pattern:
    """Parse a topic's name or a pattern of names.

    Raises:
        argparse.ArgumentTypeError: it is neither a name nor a pattern.
    """
    if not is_valid(text):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a topic's name (/scan) nor a pattern (/camera/**)")
    return Pattern(text)
