"""UDP sockets."""

from __future__ import annotations

import asyncio
import socket

from rsb_bridge.transport.streams import StreamHandler
from rsb_bridge.transport.transport import Acceptor
from rsb_bridge.transport.udp import Udp


def test_a_peer_that_roams_does_not_make_the_table_of_sizes_grow() -> None:
    async def main() -> None:
        bound = await Udp().listen("127.0.0.1", 0, Acceptor(StreamHandler, lambda *_: None, lambda _: None))
        (sock,) = bound.sockets
        for number in range(1000):
            assert sock.datagram_size((f"127.0.{number // 250}.{number % 250 + 1}", 1000)) > 1000
        assert len(sock._sizes) <= 256
        bound.close()

    asyncio.run(main())


class _Counted(bytes):
    """A datagram that counts how often its length is asked for."""

    asked = 0

    def __len__(self) -> int:
        _Counted.asked += 1
        return super().__len__()


def test_what_waits_is_not_counted_anew_for_each_message() -> None:
    """One link's large message waits for its turn, and all links send on the same socket meanwhile."""

    async def run() -> int:
        with socket.socket(type=socket.SOCK_DGRAM) as peer:
            peer.bind(("127.0.0.1", 0))
            udp = Udp().connect(peer.getsockname(), lambda *_: None)
            udp.send([_Counted(1400) for _ in range(5000)], None)
            assert udp.congested
            _Counted.asked = 0
            for _ in range(1000):
                udp.send([_Counted(1400)], None)
            udp.close()
        return _Counted.asked

    assert asyncio.run(run()) <= 10 * 1000


def test_what_waits_is_bounded() -> None:
    async def run() -> int:
        with socket.socket(type=socket.SOCK_DGRAM) as peer:
            peer.bind(("127.0.0.1", 0))
            udp, sent = Udp().connect(peer.getsockname(), lambda *_: None), asyncio.Event()
            udp.when_writable.add(sent.set)
            for _ in range(40):
                udp.send([bytes(1400)] * 1000, None)
            waiting = udp.waiting_bytes
            await sent.wait()
            assert udp.waiting_bytes == 0
            udp.close()
        return waiting

    assert 16 << 20 <= asyncio.run(run()) <= (16 << 20) + 1_400_000
