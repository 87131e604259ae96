"""One line of progress on a terminal, which is gone when the work is done."""

from __future__ import annotations

import contextlib
import shutil
from typing import TYPE_CHECKING, Self, TextIO

from rsb_bridge.model.text import one_line

if TYPE_CHECKING:
    from types import TracebackType

_ERASE = "\r\x1b[K"


class Progress:
    """Shown on a terminal only; elsewhere nothing is written.

    Args:
        stream: standard error, as a rule.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._shows = stream.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._shows:
            self._write(_ERASE)

    def show(self, text: str) -> None:
        """Show a line in the place of the one before."""
        if self._shows:
            self._write(f"{_ERASE}{one_line(text)[: shutil.get_terminal_size().columns - 1]}")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # the terminal has gone
            self._stream.write(text)
            self._stream.flush()
