"""The ports that a server has open for its links."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.session import Session
    from rsb_bridge.transport.registry import Transports
    from rsb_bridge.transport.transport import Acceptor, Listener


class PortProblem(Wording):
    """The reasons why a port is not open."""

    CLOSED_AGAIN = "{kind} {number} was closed while it was being opened"


@dataclass(slots=True)
class _Port:
    listener: Listener
    users: int = 0


class Ports:
    """Bound ports by transport and number, each open as long as somebody uses it."""

    def __init__(self, session: Session, transports: Transports, acceptor: Acceptor) -> None:
        self._session = session
        self._transports = transports
        self._acceptor = acceptor
        self._ports: dict[tuple[str, int], _Port] = {}
        self._opening = asyncio.Lock()
        self._closings = 0

    async def open(self, name: str, number: int) -> Callable[[], None]:
        """Use a port of the transport of that name; it is bound if nobody uses it yet.

        Returns:
            What to call when it is no longer used.

        Raises:
            ListenError: it can't be bound, or all are closed meanwhile.
        """
        key, closed = (name, number), self._closings
        # Two topics that name one port would bind it twice.
        async with self._opening:
            port = self._ports.get(key)
            if port is None:
                transport = self._transports[name]
                port = _Port(await transport.listen(transport.host(self._session), number, self._acceptor))
                if closed != self._closings:  # a server that has stopped meanwhile would leave the port bound
                    port.listener.close()
                    raise ListenError(PortProblem.CLOSED_AGAIN(kind=transport.port_kind, number=number))
                self._ports[key] = port
        port.users += 1
        return lambda: self._release(key, port)

    def _release(self, key: tuple[str, int], port: _Port) -> None:
        port.users -= 1
        # After `close`, a new one may have the same number.
        if not port.users and self._ports.get(key) is port:
            del self._ports[key]
            port.listener.close()

    def close(self) -> None:
        """Close all ports, including ports that are being opened."""
        self._closings += 1
        for port in self._ports.values():
            port.listener.close()
        self._ports.clear()
