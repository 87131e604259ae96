"""An engine that operators attach to over a network, by TCP sockets of this machine."""

from __future__ import annotations

import asyncio
import hashlib
import socket
from collections import deque
from typing import TYPE_CHECKING, Any, Self

from tests.console.scripted import ScriptedEngine
from tests.support.acceptors import close_server

from rsb_bridge import __version__
from rsb_bridge.config.keys import Key
from rsb_bridge.config.operator_keys import Granted
from rsb_bridge.control.protocol import VERSION, ConsoleHello, ConsoleWelcome, encode, frames_to_console
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.control.sealed import OperatorConnector, SealedAcceptor
from rsb_bridge.engine.access import Access
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.session import Operator
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.wire.connection import OperatorConsole
from rsb_bridge.wire.events import Admitted, OperatorOpened

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_bridge.control.protocol import ToBridge, ToConsole
    from rsb_bridge.control.sealed import Connect
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.session import OperatorMay
    from rsb_bridge.model.snapshot import Event
    from rsb_bridge.wire.events import Event as WireEvent

ANNA, BOB = (Key(hashlib.sha256(name).digest()) for name in (b"anna", b"bob"))


def granted(name: str, key: Key, may: OperatorMay = "change") -> dict[str, Granted]:
    """One operator's entry in `Access.granted`."""
    return {name: Granted(Operator(name, f"{name}.key", may), key)}


def _anna_and_bob() -> Access:
    access = Access("robot1", EventLog(Clock()), Clock())
    access.grant(granted("anna", ANNA) | granted("bob", BOB, "look"))
    return access


class Reachable:
    """A scripted engine, robot1, that anna may change and bob look at.

    Args:
        machine: serves it on a control socket, too.
        engine: another one to serve.
        access: who may attach, or None for anna and bob.
        changes: of how it is served, as in `Machine.serve`.

    Attributes:
        access: says who may attach.
        server: of this machine's consoles, and of operators.
        port: that it listens on, on 127.0.0.1.
    """

    def __init__(self, machine: Machine, engine: Any = None, access: Access | None = None, **changes: Any) -> None:
        self.engine = ScriptedEngine() if engine is None else engine
        self.access = access or _anna_and_bob()
        self.server = machine.serve(self.engine, **changes)
        self.acceptor = SealedAcceptor(self.server, self.access)
        self.port = asyncio.run_coroutine_threadsafe(self._listen(), self.server.loop).result(60)
        self._machine = machine
        self._closed = False
        machine.in_the_end(self.close)

    def close(self) -> None:
        """Listen no more; who is attached stays."""
        if not self._closed:
            self._closed = True
            asyncio.run_coroutine_threadsafe(self._close(), self.server.loop).result(60)

    async def _listen(self) -> int:
        self._listening = await self.server.loop.create_server(self.acceptor.protocol, "127.0.0.1", 0)
        port: int = self._listening.sockets[0].getsockname()[1]
        return port

    async def _close(self) -> None:
        await close_server(self._listening)

    def way(self, name: str = "anna", key: Key = ANNA, engine: str = "robot1", port: int = 0) -> OperatorConnector:
        """An operator's way to it; or by another port, where somebody is in between."""

        return OperatorConnector(self.connect(port), name, key, engine)

    def connect(self, port: int = 0) -> Connect:
        """Makes streams to it."""

        async def connect(protocol: asyncio.Protocol) -> None:
            await asyncio.get_running_loop().create_connection(lambda: protocol, "127.0.0.1", port or self.port)

        return connect

    def attach(self, name: str = "anna", key: Key = ANNA, **how: Any) -> RemoteEngine:
        remote = RemoteEngine(self.way(name, key, **how))
        remote.start()
        self._machine.in_the_end(remote.stop)
        return remote

    def events(self, *codes: EventCode) -> list[Event]:
        return [event for event in self.access.events.after(0) if event.code in codes]


class Stranger:
    """A socket to the engine's port, and a console's end of the handshake to use on it.

    Args:
        port: the engine's.
    """

    def __init__(self, port: int, name: str = "anna", key: Key = ANNA, engine: str = "robot1") -> None:
        self.console = OperatorConsole(name, key.secret, engine, version=VERSION, host="pc")
        self.socket = socket.create_connection(("127.0.0.1", port), 60.0)
        self._frames = frames_to_console()
        self._heard: deque[ToConsole] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def hear(self) -> list[WireEvent]:
        """Return the next message, decrypted, or nothing if the engine has closed the connection."""
        try:
            data = self.socket.recv(64 << 10)
        except ConnectionResetError:
            return []
        events = self.console.receive_data(data) if data else []
        if answer := self.console.data_to_send():
            self.send(answer)
        return events or (self.hear() if data else [])

    def is_closed(self) -> bool:
        """Wait for the engine to close the connection, and drop its messages before that."""
        try:
            while self.socket.recv(64 << 10):
                pass
        except ConnectionResetError:
            pass
        return True

    def attach(self, *, read_only: bool = False) -> None:
        self.send(self.console.start())
        assert self.hear() == [Admitted()]
        self.say(ConsoleHello(VERSION, __version__, read_only))
        assert isinstance(self.answer(), ConsoleWelcome)

    def say(self, message: ToBridge) -> None:
        """Send a message of the control protocol, sealed."""
        self.send(self.console.send(encode(message)))

    def answer(self) -> ToConsole:
        """The next message of the control protocol; it keeps the messages that came together with it."""
        while not self._heard:
            for event in self.hear():
                assert isinstance(event, OperatorOpened)
                self._heard.extend(self._frames.feed(event.content))
        return self._heard.popleft()
