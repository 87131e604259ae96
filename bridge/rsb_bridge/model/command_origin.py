"""Who gives the command that is being carried out."""

from __future__ import annotations

import contextlib
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

OWN_CONSOLE = "the bridge's own console"

_operator = ContextVar("operator", default=OWN_CONSOLE)
_undo = ContextVar("undo", default=False)


def operator() -> str:
    """Whoever gives the present command, in words.

    A task has the operator of the code that started it, on another thread, too.
    """
    return _operator.get()


@contextlib.contextmanager
def acting(who: str) -> Iterator[None]:
    """Give commands in somebody's name.

    Args:
        who: in words: ``anna on pts/3``.
    """
    token = _operator.set(who)
    try:
        yield
    finally:
        _operator.reset(token)


def is_undo() -> bool:
    """Whether the present command takes back an earlier one of the same operator."""
    return _undo.get()


@contextlib.contextmanager
def undoing(undo: bool = True) -> Iterator[None]:
    """Mark the commands given inside as ones that take back earlier commands."""
    token = _undo.set(undo)
    try:
        yield
    finally:
        _undo.reset(token)


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
