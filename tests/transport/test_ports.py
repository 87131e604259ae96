"""A server's ports, and who closes them while they are being opened."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import pytest
from tests.support.wording import pattern

from rsb_bridge.model.session import Session
from rsb_bridge.transport.ports import PortProblem, Ports
from rsb_bridge.transport.registry import Transports
from rsb_bridge.transport.transport import Acceptor, Listener, ListenError
from rsb_bridge.transport.udp import Udp

SESSION = Session(name="control", role="server", server_ip="127.0.0.1", server_port=9000)


class SlowUdp(Udp):
    """A name server takes its time."""

    def __init__(self) -> None:
        self.listens = asyncio.Event()
        self.goes_on = asyncio.Event()
        self.listening = 0

    async def listen(self, host: str, port: int, acceptor: Acceptor) -> Listener:  # type: ignore[override]
        self.listens.set()
        await self.goes_on.wait()
        self.listening += 1
        return cast("Listener", SimpleNamespace(close=self._close))

    def _close(self) -> None:
        self.listening -= 1


async def test_port_closed_while_opening_stays_closed() -> None:
    udp = SlowUdp()
    ports = Ports(SESSION, Transports(udp), cast("Acceptor", None))
    opening: asyncio.Task[Callable[[], None]] = asyncio.create_task(ports.open("udp", 9000))
    waiting = asyncio.create_task(ports.open("udp", 9001))
    await udp.listens.wait()
    ports.close()
    udp.goes_on.set()
    for each in (opening, waiting):
        with pytest.raises(ListenError, match=pattern(PortProblem.CLOSED_AGAIN)):
            await each
    assert udp.listening == 0
    release = await ports.open("udp", 9000)
    assert udp.listening == 1
    release()
    assert udp.listening == 0
