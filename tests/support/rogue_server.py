"""A server that holds a client's key and does to it what no control PC would."""

from __future__ import annotations

import os
import socket
from typing import Self

from tests.support.rogue import whole

from rsb_bridge.wire.connection import ServerConnection
from rsb_bridge.wire.events import Established, MessageReceived
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import ControlMessageBase, Hello, Welcome
from rsb_bridge.wire.sealed_stream import Credential, ReplayCache


class RogueServer:
    """Accepts one client at a time, on blocking sockets."""

    def __init__(self, port: int, key: bytes | None, timeout: float = 60.0) -> None:
        self._keys = () if key is None else (key,)
        self._timeout = timeout
        self._listener = socket.create_server(("127.0.0.1", port))
        self._listener.settimeout(timeout)
        self._connection = self._new_connection()
        self._control: socket.socket | None = None
        self.heard: list[ControlMessageBase] = []

    def _new_connection(self) -> ServerConnection:
        replays = ReplayCache()
        return ServerConnection(lambda _: Credential(self._keys, replays), self._welcome, aes=True)

    def _welcome(self, hello: Hello) -> Welcome:
        return Welcome("0.1.0", hello.name, os.urandom(8), "rogue", 0)

    def accept(self) -> None:
        """Wait for the client, and link with it."""
        self._control, _ = self._listener.accept()
        self._control.settimeout(self._timeout)
        self._connection = self._new_connection()
        while not any(isinstance(event, Established) for event in self._read()):
            pass

    def say(self, *messages: ControlMessageBase) -> None:
        assert self._control is not None
        self._control.sendall(b"".join(self._connection.send(message) for message in messages))

    def hear(self) -> bool:
        """Wait for more of what the client says, and keep it in `heard`; whether it is still there."""
        return bool(self._read())

    def _read(self) -> list[object]:
        assert self._control is not None
        data = self._control.recv(CONTROL_LIMIT)
        if not data:
            return []
        events: list[object] = list(self._connection.receive_data(data))
        self._control.sendall(self._connection.data_to_send())
        self.heard += [whole(event.content) for event in events if isinstance(event, MessageReceived)]
        return events or [None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Go without a word."""
        self._listener.close()
        if self._control is not None:
            self._control.close()
