"""The operator and the console of the command that is being executed."""

from __future__ import annotations

import contextlib
from contextvars import ContextVar
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator
    from contextlib import AbstractContextManager

T = TypeVar("T")

OWN_CONSOLE = "the bridge's own console"

_operator = ContextVar("operator", default=OWN_CONSOLE)
_undo = ContextVar("undo", default=False)


def operator() -> str:
    """Return the operator of the present command, in words.

    A task has the operator of the code that started it, on another thread, too.
    """
    return _operator.get()


@contextlib.contextmanager
def _set(variable: ContextVar[T], value: T) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def acting(who: str) -> AbstractContextManager[None]:
    """Give commands in the name of an operator.

    Args:
        who: the operator in words: ``anna on pts/3``.
    """
    return _set(_operator, who)


def is_undo() -> bool:
    """Whether the present command undoes an earlier one of the same operator."""
    return _undo.get()


def undoing(undo: bool = True) -> AbstractContextManager[None]:
    """Mark the commands given inside as undoing earlier commands."""
    return _set(_undo, undo)


OWN = "own"
"""The console of the bridge's own process."""

_console: ContextVar[Hashable] = ContextVar("console", default=OWN)


def console() -> Hashable:
    """Return the identity of the present command's console.

    A task has the console of the code that started it, on another thread, too.
    """
    return _console.get()


def on_console(which: Hashable) -> AbstractContextManager[None]:
    return _set(_console, which)
