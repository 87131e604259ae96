"""Somebody between an operator's console and an engine: what they can read, change, cut and forward."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.support.acceptors import close_server
from tests.support.operators import ANNA, Reachable
from tests.support.waiting import eventually

from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.control.sealed import OperatorConnector
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.control import Machine


class Between:
    """Forwards each connection to an engine.

    Attributes:
        port: that it listens on, on 127.0.0.1.
        seen: all that it has forwarded.
        change: is given what an engine says, and gives what the console gets.
    """

    def __init__(self, robot: Reachable) -> None:
        self.robot = robot
        self.seen = bytearray()
        self.change: Callable[[bytes], bytes] = bytes
        self._loop = robot.server.loop
        self._writers: list[asyncio.StreamWriter] = []
        self.port: int = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result(60)

    async def _listen(self) -> int:
        self._server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, to_engine = await asyncio.open_connection("127.0.0.1", self.robot.port)
        self._writers += [writer, to_engine]
        back = asyncio.create_task(self._pump(there, writer, self._changed))
        await self._pump(reader, to_engine, bytes)
        await back

    def _changed(self, data: bytes) -> bytes:
        return self.change(data)

    async def _pump(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, change: Callable[[bytes], bytes]
    ) -> None:
        try:
            while data := await reader.read(64 << 10):
                self.seen += data
                writer.write(change(data))
        except OSError:
            pass
        writer.close()

    def cut(self) -> None:
        """End all connections, and take no new ones."""

        async def cut() -> None:
            await close_server(self._server)
            for writer in self._writers:
                writer.transport.abort()

        asyncio.run_coroutine_threadsafe(cut(), self._loop).result(60)


@pytest.fixture
def between(reachable: Reachable, machine: Machine) -> Between:
    made = Between(reachable)
    machine.in_the_end(made.cut)
    return made


def test_who_forwards_sees_no_word_of_it(reachable: Reachable, between: Between) -> None:
    remote = reachable.attach(port=between.port)
    (route, *_) = remote.snapshot().routes
    assert len(between.seen) > 1000
    assert b"anna" in between.seen, "who attaches is in the clear"
    for word in (route.topic.encode(), b"snapshot", b"welcome", ANNA.secret):
        assert word not in between.seen


def test_changed_bytes_are_noticed_then_attached_again(reachable: Reachable, between: Between) -> None:
    remote = reachable.attach(port=between.port)
    between.change = lambda data: data[:-1] + bytes((data[-1] ^ 1,))
    eventually(lambda: remote.snapshot() and [each for each in remote.events() if each.code == EventCode.ATTACH_LOST])
    between.change = bytes
    eventually(lambda: [each for each in remote.events() if each.code == EventCode.ATTACH_AGAIN])
    eventually(lambda: not remote.unreachable)


def test_cut_connection_is_told_on_both_sides(reachable: Reachable, between: Between) -> None:
    remote = reachable.attach(port=between.port)
    between.cut()
    eventually(lambda: remote.unreachable)
    eventually(lambda: reachable.events(EventCode.ATTACH_OPERATOR_LEFT))


def test_what_ends_connection_before_answer_is_said() -> None:
    """And not only that nobody answered."""

    async def connect(protocol: asyncio.Protocol) -> None:
        protocol.connection_lost(OSError("connection reset"))

    with pytest.raises(ControlError, match="connection reset"):
        asyncio.run(OperatorConnector(connect, "anna", ANNA, "robot1").open(60.0))
