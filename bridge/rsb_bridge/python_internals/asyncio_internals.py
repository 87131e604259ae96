"""The inside of asyncio's event loop and of its selector."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import selectors
    from collections import deque
    from collections.abc import Callable


class ObservedLoop(asyncio.SelectorEventLoop):
    """An event loop that tells other threads whether it has work. asyncio's public methods ask that on its own only."""

    _debug: bool
    _ready: deque[asyncio.Handle]
    _thread_id: int | None

    @property
    def waits(self) -> bool:
        """Whether it runs, and has no callback to run. In debug mode, which refuses other threads, never."""
        return not self._ready and self._thread_id is not None and not self._debug


def poll_of(selector: selectors.EpollSelector) -> Callable[[float, int], list[tuple[int, int]]]:
    """Return epoll's own `poll`, with a limit on events: `select` makes a key of each, which takes longer."""
    poll: Callable[[float, int], list[tuple[int, int]]] = selector._selector.poll  # type: ignore[attr-defined]
    return poll


def reader_of(key: selectors.SelectorKey) -> Callable[[], object]:
    """Return what asyncio calls once a socket is readable. asyncio itself calls it one turn of the loop later."""
    callback, args = key.data[0]._callback, key.data[0]._args  # a pair of handles, for reading and for writing
    return partial(callback, *args) if args else callback
