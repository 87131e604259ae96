"""What the command's parts share: exit codes, and where words go."""

from __future__ import annotations

import sys

OK, FAILURE, USAGE, INTERRUPTED = 0, 1, 2, 130


def say(text: str) -> None:
    """Write a line to standard output. What its encoding lacks is escaped: a name may be in any script."""
    encoding = sys.stdout.encoding
    sys.stdout.write(f"{text}\n".encode(encoding, "backslashreplace").decode(encoding))


def complain(text: str) -> None:
    """Write a message to standard error, under the command's name."""
    sys.stderr.write(f"rsb-console: {text}\n")
