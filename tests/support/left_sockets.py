"""A pytest plugin: a test that leaves a socket to the collector fails itself, not a stranger much later."""

from __future__ import annotations

import gc
import socket
from functools import wraps
from typing import TYPE_CHECKING, Any
from weakref import ref

import pytest
from _pytest.unraisableexception import collect_unraisable

if TYPE_CHECKING:
    from collections.abc import Generator

_made: list[ref[socket.socket]] = []
_make = socket.socket.__init__


@wraps(_make)
def _note(self: socket.socket, *given: Any, **named: Any) -> None:
    _make(self, *given, **named)
    _made.append(ref(self))


def pytest_configure() -> None:
    socket.socket.__init__ = _note  # type: ignore[method-assign]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None]:
    """Have the collector run if a socket that the test made is open: among many objects that takes 0.1 s."""
    yield
    getattr(item, "funcargs", {}).clear()  # pytest drops them later
    made = [each() for each in _made]
    _made.clear()
    if any(each is not None and each.fileno() != -1 for each in made):
        del made
        gc.collect()
        collect_unraisable(item.config)
