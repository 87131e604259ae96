"""UDP sockets."""

from __future__ import annotations

import asyncio

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
