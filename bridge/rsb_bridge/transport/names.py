"""Looks up names, each in a thread that nobody joins. An address needs no thread.

The event loop's own lookup runs in a pool that other work shares, and that is joined when the process ends: a name
server that does not answer would hold up both.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Sequence
from typing import Any

Found = Sequence[tuple[int | socket.AddressFamily, int | socket.SocketKind, int, str, tuple[Any, ...]]]


async def look_up(host: str, port: int, within: float) -> Found:
    """The stream addresses of a host, as `socket.getaddrinfo` gives them.

    Args:
        host: a name or an address.
        port: of the addresses.
        within: s until the lookup is given up.

    Raises:
        OSError: the name is not known, or no name server answers.
    """
    with contextlib.suppress(socket.gaierror):
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[Found] = loop.create_future()

    def settle(found: Found | OSError) -> None:
        if answer.done():
            return
        if isinstance(found, OSError):
            answer.set_exception(found)
        else:
            answer.set_result(found)

    def ask() -> None:
        found: Found | OSError
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError as error:
            found = error
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, found)

    threading.Thread(target=ask, name="look-up", daemon=True).start()
    try:
        async with asyncio.timeout(within):
            return await answer
    except TimeoutError:
        raise OSError(f"the name can't be looked up: no name server answers within {within:g} s") from None
