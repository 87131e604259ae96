"""The RFCOMM transport over the machine's virtual radio."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.acceptors import Accepting
from tests.support.wording import pattern

from rsb_bridge.bluetooth.hci import ANY_ADAPTER
from rsb_bridge.transport.rfcomm import Rfcomm, RfcommProblem
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.transport.transport import ListenError

from .conftest import holding

if TYPE_CHECKING:
    from rsb_bridge.model.reason import Reason

_DEADLINE = 20.0


class Recorder(StreamHandler):
    """One end of a connection, which keeps the bytes that arrive.

    Attributes:
        data: all that was received.
        reason: why it is over.
    """

    def __init__(self) -> None:
        self.stream: Stream | None = None
        self.data = bytearray()
        self.reason = ""
        self._changed = asyncio.Event()

    def connected(self, stream: Stream) -> None:
        self.stream = stream
        self._changed.set()

    def received(self, data: bytes) -> None:
        self.data += data
        self._changed.set()

    def writable(self) -> None:
        self._changed.set()

    def closed(self, reason: Reason) -> None:
        self.reason = reason.text
        self._changed.set()

    async def until(self, condition: Callable[[Recorder], object]) -> None:
        """Wait until something is so of this end."""
        async with asyncio.timeout(_DEADLINE):
            while not condition(self):
                self._changed.clear()
                await self._changed.wait()

    async def send(self, data: bytes) -> None:
        """Write as the engine does: not while congested."""
        stream = self.stream
        assert stream is not None
        for start in range(0, len(data), 2048):
            await self.until(lambda _: not stream.congested)
            stream.write(data[start : start + 2048])


class Pair:
    """A listener's accepted ends, and what connects to it."""

    def __init__(self, address: str, channel: int) -> None:
        self.address, self.channel = address, channel
        self.accepted: list[Recorder] = []
        self.called: list[Recorder] = []
        self._newest: asyncio.Queue[Recorder] = asyncio.Queue()

    def accept(self) -> Recorder:
        self.accepted.append(Recorder())
        self._newest.put_nowait(self.accepted[-1])
        return self.accepted[-1]

    async def connect(self) -> tuple[Recorder, Recorder]:
        """A new connection: the client's end and the server's."""
        self.called.append(client := Recorder())
        await Rfcomm().connect(self.address, self.channel, client)
        async with asyncio.timeout(_DEADLINE):
            server = await self._newest.get()
        await server.until(lambda end: end.stream)
        return client, server


@asynccontextmanager
async def listening(address: str, channel: int, bind: str = "") -> AsyncIterator[Pair]:
    pair = Pair(address, channel)
    server = await Rfcomm().listen(bind or address, channel, Accepting(pair.accept))
    try:
        yield pair
    finally:
        server.close()
        for end in pair.accepted + pair.called:
            if end.stream is not None:
                end.stream.abort("test over")


async def test_both_ways_intact(addresses: tuple[str, str]) -> None:
    there, back = os.urandom(300_000), os.urandom(300_000)
    async with listening(addresses[0], 4) as pair:
        client, server = await pair.connect()
        assert client.stream is not None
        assert server.stream is not None
        assert client.stream.peer == f"{addresses[0]} channel 4"
        assert server.stream.host == addresses[1]
        await asyncio.gather(client.send(there), server.send(back))
        for end in (client, server):
            await end.until(lambda end: len(end.data) == 300_000)
        assert bytes(client.data) == back
        assert bytes(server.data) == there
        client.stream.close("enough")
        await client.until(lambda end: end.reason)
        await server.until(lambda end: end.reason)
        assert client.reason == "enough"
        assert server.reason.startswith("Connection reset by peer: ")


async def test_what_was_written_arrives_before_the_end(addresses: tuple[str, str]) -> None:
    async with listening(addresses[0], 4) as pair:
        client, server = await pair.connect()
        assert client.stream is not None
        client.stream.write(bytes(60_000))
        client.stream.close("enough")
        await server.until(lambda end: end.reason)
        assert len(server.data) == 60_000


async def test_reconnecting_at_once(addresses: tuple[str, str]) -> None:
    async with listening(addresses[0], 5, bind=ANY_ADAPTER) as pair:
        for turn in range(20):
            client, server = await pair.connect()
            closes_first = client if turn % 2 else server
            assert closes_first.stream is not None
            closes_first.stream.abort("again")
        await client.until(lambda end: end.reason)
        assert len(pair.accepted) == 20


async def test_refusals_are_explained(addresses: tuple[str, str]) -> None:
    started = time.monotonic()
    with pytest.raises(OSError, match=pattern(RfcommProblem.NOBODY_LISTENS, channel=9)):
        await Rfcomm().connect(addresses[0], 9, Recorder())
    assert 1.0 < time.monotonic() - started < 5.0
    async with listening(addresses[0], 7) as pair:
        await pair.connect()
        with pytest.raises(OSError, match=pattern(RfcommProblem.CHANNEL_IN_USE, channel=7)):
            await Rfcomm().connect(addresses[0], 7, Recorder())


async def test_an_absent_peer_is_not_waited_for(addresses: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    constants.RFCOMM_CONNECT_TIMEOUT.set(monkeypatch, 2.0)
    started = time.monotonic()
    with pytest.raises(OSError, match=pattern(RfcommProblem.NO_ANSWER)):
        await Rfcomm().connect("00:11:22:33:44:55", 5, Recorder())
    assert time.monotonic() - started < 4.0
    async with listening(addresses[0], 5) as pair:  # and it leaves nothing behind that would be in the way
        await pair.connect()


async def test_what_cannot_be_bound(addresses: tuple[str, str]) -> None:
    absent = RfcommProblem.ANOTHER_ADAPTER(host="00:11:22:33:44:55", adapters=", ".join(addresses))
    with pytest.raises(ListenError, match=absent):
        await Rfcomm().listen("00:11:22:33:44:55", 3, Accepting(Recorder))
    with (
        holding((addresses[0], 3, "listen")),
        pytest.raises(ListenError, match=pattern(RfcommProblem.CHANNEL_TAKEN, channel=3)),
    ):
        await Rfcomm().listen(addresses[0].lower(), 3, Accepting(Recorder))
