"""How an operator's console comes to an engine over a network: whatever carries the bytes sees them sealed."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, TypeAlias, cast

from rsb_bridge.control import protocol
from rsb_bridge.control.folders import ControlError
from rsb_bridge.transport.streams import OpenNetworkTransport
from rsb_bridge.wire.events import Admitted, Failed, Opened, Refused
from rsb_bridge.wire.operators import OperatorConsole
from rsb_bridge.wire.preamble import RefusalCode

if TYPE_CHECKING:
    from rsb_bridge.config.keys import Key
    from rsb_bridge.control.ways import Connection

Connect: TypeAlias = Callable[[asyncio.Protocol], Awaitable[object]]
"""Makes a stream to the engine and gives it a protocol, whose ``connection_made`` it calls on the running loop; the
stream is what asyncio calls a transport, as in `rsb_bridge.control.sealed`. What goes wrong is an OSError or a
ControlError."""

_REFUSED_AFTER = 1.5
"""s from a refusal, which anybody in a Zenoh network can forge, until it counts: the engine's answer may follow."""
_READ_SIZE = 256 << 10
_HELD = 1 << 20
"""Bytes that wait to be read, of which twice as many stop the stream."""
_REMEDIES = {
    RefusalCode.WRONG_KEY: "give the key file that the engine's session names for this operator",
    RefusalCode.UNKNOWN_NAME: "give the name of the engine's session, and a name under its operators",
}


class Sealed:
    """A way to an engine over a network, with an operator's key.

    Args:
        connect: makes a stream to the engine.
        operator: as the engine's session names them.
        key: the operator's.
        engine: the name of the session that is meant: no other one can answer in its place.
        at: the engine's address in a Zenoh network, or empty.
    """

    same_machine = False

    def __init__(self, connect: Connect, operator: str, key: Key, engine: str, at: str = "") -> None:
        self._connect = connect
        self._operator = operator
        self._key = key
        self._engine = engine
        self._at = at

    @property
    def text(self) -> str:
        return self._engine

    async def open(self, within: float) -> Connection:
        """Connect, and prove to each other who is there."""
        console = OperatorConsole(
            self._operator, self._key.secret, self._engine, version=protocol.VERSION, host=socket.gethostname()
        )
        connection = _Sealed(console, self._engine, self._at)
        try:
            async with asyncio.timeout(within):
                await self._connect(connection)
                await connection.admitted
        except BaseException:
            connection.abort()
            raise
        return connection


class _Sealed(asyncio.Protocol):
    """One connection: what comes is opened and waits to be read."""

    def __init__(self, machine: OperatorConsole, engine: str, at: str) -> None:
        loop = asyncio.get_running_loop()
        self.admitted: asyncio.Future[None] = loop.create_future()
        self._machine = machine
        self._engine = engine
        self._at = at
        self._trial: OpenNetworkTransport | None = None
        self._refused = False
        self._reader = asyncio.StreamReader(_HELD, loop)
        self._transport: asyncio.Transport | None = None
        self._ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        if self._ended:  # given up meanwhile
            self._transport.abort()
            return
        self._reader.set_transport(self._transport)
        if isinstance(transport, OpenNetworkTransport):
            self._trial = transport
            transport.begin_trial()
        self._transport.write(self._machine.start())

    def data_received(self, data: bytes) -> None:
        if self._ended:
            return
        assert self._transport is not None
        if self._trial is not None and not self._prove(self._trial, data):
            return
        events = self._machine.receive_data(data)
        self._transport.write(self._machine.data_to_send())
        for event in events:
            match event:
                case Admitted():
                    if not self.admitted.done():
                        self.admitted.set_result(None)
                case Opened(content):
                    self._reader.feed_data(content)
                case Refused() | Failed():
                    self._end(self._reason_of(event))
                case _:
                    raise AssertionError("an event of links")

    def _prove(self, transport: OpenNetworkTransport, data: bytes) -> bool:
        """Whether an answer proves the key; anybody in the network may answer, also in the engine's name."""
        machine = self._machine.fork()
        events = machine.receive_data(data)
        if machine.proven and machine.at in ("", self._at):
            transport.adopt()
            self._machine, self._trial = self._machine.fork(), None
            if machine.sample_secret is not None:
                transport.authenticate(machine.sample_secret, opener=True)
            return True
        for event in events:
            if isinstance(event, Refused | Failed) and not self._refused:
                self._refused = True
                asyncio.get_running_loop().call_later(_REFUSED_AFTER, self._refuse, event)
        return False

    def _refuse(self, event: Refused | Failed) -> None:
        """Take a refusal that nothing better has followed."""
        if self._trial is not None and not self._ended:
            self._end(self._reason_of(event))

    def _reason_of(self, event: Refused | Failed) -> str:
        if isinstance(event, Refused):
            remedy = f": {_REMEDIES[event.code]}" if event.code in _REMEDIES else ""
            return f"{self._engine} refuses: {event.message}{remedy}"
        return f"{self._engine}: {event.reason}"

    def eof_received(self) -> bool:
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        if self._ended:
            return
        if exc is not None:
            self._end(f"{self._engine}: {getattr(exc, 'strerror', None) or exc}")
        elif not self.admitted.done():
            self._end(f"{self._engine}: the connection was closed before anybody answered")
        else:
            self._ended = True
            self._reader.feed_eof()

    def _end(self, reason: str) -> None:
        """The connection is of no use any more."""
        error = ControlError(reason)
        self._ended = True
        self._reader.set_exception(error)
        if not self.admitted.done():
            self.admitted.set_exception(error)
            self.admitted.exception()  # who waits is told; that nobody does is no failure of its own
        if self._transport is not None:
            self._transport.abort()

    async def read(self) -> bytes:
        """As `rsb_bridge.control.ways.Connection`, likewise those below."""
        return await self._reader.read(_READ_SIZE)

    def write(self, data: bytes) -> None:
        """Seal and send."""
        if not self._ended and self._transport is not None and not self._transport.is_closing():
            self._transport.write(self._machine.send(data))

    def abort(self) -> None:
        """Close, and forget what waits."""
        self._ended = True
        self.admitted.cancel()
        if self._transport is not None:
            self._transport.abort()
