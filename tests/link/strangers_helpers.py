"""Helpers of `test_strangers` and others."""

from __future__ import annotations

import asyncio
import os
import struct
import weakref
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.inside import inside

from rsb_bridge.link.link_server import Server
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine
    from rsb_bridge.model.budgets import Strangers


def first_message(name: str = "robot1", key: bytes | None = None) -> bytes:
    return ClientConnection(Hello("1", name, "x", 0), key or os.urandom(32), CipherSuite.AESGCM).start()


SAID = {
    "nothing": b"",
    "rubbish": os.urandom(200_000),
    "a frame that never ends": struct.pack(">I", 4096) + b"rsb\x01\x01",
    "a wrong key": first_message(),
    "a wrong key, and more": first_message() + bytes(1_000_000),
    "an unknown name": first_message("nobody"),
    "a stream's preamble": struct.pack(">I", 30) + b"rsb\x01\x02" + bytes(25),
    "HTTP": b"GET / HTTP/1.1\r\n\r\n",
}


@pytest.fixture
def arrived(monkeypatch: pytest.MonkeyPatch) -> list[weakref.ref[object]]:
    """All that servers have made for each stream that came in."""
    made: list[weakref.ref[object]] = []
    arrive, connected = Server.make_handler, Stream.connection_made

    def arrives(self: Server) -> StreamHandler:
        handler: Any = arrive(self)
        made.extend((weakref.ref(handler), weakref.ref(handler._connection)))
        return handler  # type: ignore[no-any-return]

    def connects(self: Stream, transport: asyncio.BaseTransport) -> None:
        made.extend((weakref.ref(self), weakref.ref(transport)))
        connected(self, transport)

    replaced.STREAM_ARRIVES.set(monkeypatch, arrives)
    replaced.STREAM_CONNECTED.set(monkeypatch, connects)
    return made


def strangers_of(engine: Engine) -> Strangers:
    return inside(engine).context.transports.strangers
