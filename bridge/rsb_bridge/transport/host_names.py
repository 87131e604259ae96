"""Addresses of host names, which take as long to come as a name server likes."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence
from typing import Any

from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.threads import in_thread

Found = Sequence[tuple[int | socket.AddressFamily, int | socket.SocketKind, int, str, tuple[Any, ...]]]


class LookUpProblem(Wording):
    """The reasons why a host's name has no address."""

    NO_NAME_SERVER = "the name can't be looked up: no name server answers within {seconds:g} s"
    NO_ADDRESS = "{host}: the name has no address"


async def look_up(
    host: str, port: int, within: float, kind: socket.SocketKind = socket.SOCK_STREAM, flags: int = 0
) -> Found:
    """Return the addresses of a host, as `socket.getaddrinfo` gives them.

    Args:
        host: a name or an address.
        within: s until the lookup is given up.
        flags: as in `socket.getaddrinfo`.

    Raises:
        OSError: the name is not known, or no name server answers.
    """
    # An address needs no thread: each stream of a link would start one.
    with contextlib.suppress(socket.gaierror):
        return socket.getaddrinfo(host, port, type=kind, flags=flags | socket.AI_NUMERICHOST)
    try:
        return await in_thread("look-up", lambda: socket.getaddrinfo(host, port, type=kind, flags=flags), within)
    except TimeoutError:
        raise OSError(LookUpProblem.NO_NAME_SERVER(seconds=within)) from None
