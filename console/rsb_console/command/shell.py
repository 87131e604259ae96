"""Exit codes, standard output and standard error of all commands."""

from __future__ import annotations

import os
import resource
import sys

from rsb_bridge.model.text import one_line, several_lines
from rsb_bridge.model.wording import Wording
from rsb_console.notation.ascii_signs import prefers_ascii, to_ascii

TYPE_CHECKING = False  # without typing, which takes a while
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any, TextIO

OK, FAILURE, USAGE, NOT_RUNNING, ALREADY_RUNNING, HUNG_UP, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 4, 129, 130, 143
NO_KEY = 3
"""``check``: the session has no mistake, but a key that it needs is not here."""
_MOST_DESCRIPTORS = 65_536  # some systems' hard limit is a billion, and some programs go through all that they may have


class CommandText(Wording):
    """Reports of a command line that is misspelt, or whose command crashed."""

    MISSPELT = "{word}: neither a command nor a file; did you mean `rsb-console {command}`?"
    OF_FEATURE = "{word}: this installation has no {feature}: install all of rsb-console"
    CRASHED_WITHOUT_LOG = "{problem} (details: again with --debug; {log}: {reason})"


class CleanErrors:
    """Standard error for argparse, logging, warnings and tracebacks, with control characters escaped."""

    def __init__(self, stream: TextIO) -> None:
        self.raw = stream

    def write(self, text: str) -> int:
        shown = several_lines(text)
        self.raw.write(to_ascii(shown) if shows_ascii(self.raw) else shown)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw, name)


def print_line(text: str) -> None:
    """Write one line to standard output, with control characters and ends of lines escaped."""
    _print(one_line(text))


def print_lines(text: str) -> None:
    """Write a text of several lines to standard output, as `print_line` does."""
    _print(several_lines(text))


def redraw_line(text: str) -> None:
    """Write a text in place of the line at a terminal's cursor, as `print_line` does; an empty one clears it."""
    _write(f"\r\x1b[K{_shown(one_line(text))}")
    sys.stdout.flush()


def _print(text: str) -> None:
    _write(f"{_shown(text)}\n")


def _shown(text: str) -> str:
    return to_ascii(text) if shows_ascii(sys.stdout) else text


def _write(text: str) -> None:
    sys.stdout.write(encoded(text).decode(sys.stdout.encoding))


def encoded(text: str) -> bytes:
    """Encode text for standard output; escape characters that its encoding lacks, as a name may be in any script."""
    return text.encode(sys.stdout.encoding, "backslashreplace")


def shows_ascii(stream: TextIO) -> bool:
    """Whether a stream leads to a terminal for which text is written in ASCII."""
    return prefers_ascii(os.environ) and stream.isatty()


def allow_many_descriptors() -> None:
    """Raise the limit on open files as far as this user may: each TCP topic takes one, and 1,024 is a usual limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _MOST_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _MOST_DESCRIPTORS)
    # RLIM_INFINITY is -1 in Python, which would seem too low.
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def print_error(text: str) -> None:
    """Write a message of one or several lines to standard error, under the command's name."""
    try:
        sys.stderr.write(several_lines(f"rsb-console: {text}\n"))
    except OSError:  # it was a terminal that has gone; Python's own flush at exit must not meet it again
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
