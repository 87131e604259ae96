"""Looks up names, each in a thread that nobody joins. An address needs no thread."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence
from typing import Any

from rsb_bridge.transport.threads import in_thread

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
    try:
        return await in_thread("look-up", lambda: socket.getaddrinfo(host, port, type=socket.SOCK_STREAM), within)
    except TimeoutError:
        raise OSError(f"the name can't be looked up: no name server answers within {within:g} s") from None
