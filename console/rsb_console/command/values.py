"""What the values of options may be. The messages are argparse's, which names the option before them."""

from __future__ import annotations

import argparse

_REMEMBERED = 120  # seconds


def seconds(text: str) -> float:
    """Parse a time.

    Args:
        text: in s.

    Raises:
        argparse.ArgumentTypeError: it is not a number above 0.
    """
    return _above_0(text, "number of seconds")


def above_0(text: str) -> float:
    """Parse a figure.

    Raises:
        argparse.ArgumentTypeError: it is not a number above 0.
    """
    return _above_0(text, "number")


def timeout(text: str) -> float:
    """Parse how long to wait; 0 only looks.

    Args:
        text: in s.

    Raises:
        argparse.ArgumentTypeError: it is not a number from 0 on.
    """
    parsed = _number(text)
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
    if not (text.isascii() and text.isdigit()) or not 1 <= int(text[:4]) <= _REMEMBERED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of seconds from 1 to {_REMEMBERED}")
    return int(text)


def _above_0(text: str, what: str) -> float:
    parsed = _number(text)
    if not 0 < parsed < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a {what} above 0")
    return parsed


def _number(text: str) -> float:
    """A number; NaN, which no range has, if it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
