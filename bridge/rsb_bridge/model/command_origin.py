"""The operator and the console of the command that is being executed."""

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
    """Return the operator of the present command, in words.

    A task has the operator of the code that started it, on another thread, too.
    """
    return _operator.get()


@contextlib.contextmanager
def acting(who: str) -> Iterator[None]:
    """Give commands in the name of an operator.

    Args:
        who: the operator in words: ``anna on pts/3``.
    """
    token = _operator.set(who)
    try:
        yield
    finally:
        _operator.reset(token)


def is_undo() -> bool:
    """Whether the present command undoes an earlier one of the same operator."""
    return _undo.get()


@contextlib.contextmanager
def undoing(undo: bool = True) -> Iterator[None]:
    """Mark the commands given inside as undoing earlier commands."""
    token = _undo.set(undo)
    try:
        yield
    finally:
        _undo.reset(token)


OWN = "own"
"""The console of the bridge's own process."""

_console: ContextVar[Hashable] = ContextVar("console", default=OWN)


def console() -> Hashable:
    """Return the identity of the present command's console.

    A task has the console of the code that started it, on another thread, too.
    """
    return _console.get()


@contextlib.contextmanager
def on_console(which: Hashable) -> Iterator[None]:
    token = _console.set(which)
    try:
        yield
    finally:
        _console.reset(token)
