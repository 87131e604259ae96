"""On which console the command is given that is being carried out."""

from __future__ import annotations

import contextlib
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

OWN = "own"
"""The console of the bridge's own process."""

_console: ContextVar[Hashable] = ContextVar("console", default=OWN)


def console() -> Hashable:
    """What tells the present command's console from all others.

    A task has the console of the code that started it, on another thread, too.
    """
    return _console.get()


@contextlib.contextmanager
def on_console(which: Hashable) -> Iterator[None]:
    """Give commands on a console."""
    token = _console.set(which)
    try:
        yield
    finally:
        _console.reset(token)
