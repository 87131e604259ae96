"""Streams of Multipath TCP, on the real kernel's loopback."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.acceptors import Accepting
from tests.support.coroutines import until
from tests.support.ports import free_port

from rsb_bridge.transport import multipath
from rsb_bridge.transport.streams import StreamHandler
from rsb_bridge.transport.tcp import Tcp, TcpStream

if TYPE_CHECKING:
    from rsb_bridge.transport.streams import Stream

needs_kernel = pytest.mark.skipif(bool(multipath.problem()), reason="this kernel has no Multipath TCP")


class Kept(StreamHandler):
    """Keeps the streams that are accepted, and echoes what they bring."""

    accepted: list[Stream]

    def connected(self, stream: Stream) -> None:
        self.accepted.append(stream)
        self._stream = stream

    def received(self, data: bytes) -> None:
        self._stream.write(data)


@pytest.mark.parametrize("there", [pytest.param(True, marks=needs_kernel), False])
@pytest.mark.parametrize("here", [pytest.param(True, marks=needs_kernel), False])
async def test_streams_have_ways_if_both_ends_can(here: bool, there: bool) -> None:
    Kept.accepted = []
    port = free_port()
    listener = await Tcp(several_ways=there).listen("127.0.0.1", port, Accepting(Kept))
    stream = await Tcp(several_ways=here).connect("127.0.0.1", port, StreamHandler())
    await until(lambda: Kept.accepted)
    stream.write(bytes(5000))
    await until(lambda: stream.received_bytes == 5000)
    for each in (stream, Kept.accepted[0]):
        counts = each.packets()
        assert counts is not None
        assert counts.sent
        # Plain TCP counts the byte of its handshake.
        assert counts.acknowledged in (5000, 5001)
        assert (counts.lost, counts.waiting, counts.tries) == (0, 0, 0)
        assert [(way.own, way.peer, way.answers) for way in each.subflows()] == (
            [("127.0.0.1", "127.0.0.1", True)] if here and there else []
        )
    stream.abort("over")
    await until(lambda: stream.gone)
    assert stream.subflows() == ()
    assert stream.packets() is None
    Kept.accepted[0].abort("over")
    listener.close()


async def test_kernel_without_it_makes_plain_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> socket.socket:
        raise OSError(errno.EPROTONOSUPPORT, "Protocol not supported")

    replaced.NEW_MULTIPATH_SOCKET.set(monkeypatch, refuse)
    assert multipath.problem()
    with socket.create_server(("127.0.0.1", 0)) as server:
        stream = await Tcp(several_ways=True).connect("127.0.0.1", server.getsockname()[1], StreamHandler())
        assert stream.subflows() == ()
        stream.abort("over")


class Unconnected(asyncio.Transport):
    """The transport of a stream whose kernel has not fallen back yet."""

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None: ...


@needs_kernel
async def test_time_to_give_up_is_set_once_the_stream_has_fallen_back() -> None:
    """Multipath TCP refuses it, and a stream may become plain TCP at any time; here, as it connects to a plain one."""
    with (
        socket.create_server(("127.0.0.1", 0)) as plain,
        multipath.new_socket(socket.AF_INET, socket.SOCK_STREAM) as sock,
    ):
        stream = TcpStream(StreamHandler(), set())
        stream.connection_made(Unconnected({"socket": sock}))
        stream.give_up_after(3.0)
        with pytest.raises(OSError, match=os.strerror(errno.EOPNOTSUPP)):
            sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
        sock.connect(plain.getsockname())
        stream.give_up_after(3.0)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 3000
