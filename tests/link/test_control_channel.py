"""A control connection is read no faster than a robot with a thousand topics needs."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.support.slices import Handlers

from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.wire.events import MessageReceived
from rsb_bridge.wire.messages import Ping

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop

_READ = 1 << 18
_SECONDS = 60
_EVERY = 0.01


class _Stream:
    """Bytes come whenever it is not paused."""

    handler: Any = None
    congested = False
    paused = False
    received_at = 0.0

    def pause_reading(self) -> None:
        self.paused = True

    def resume_reading(self) -> None:
        self.paused = False


def test_long_messages_are_taken_in_slowly(loop: VirtualLoop) -> None:
    """To read 1 MB of a control message takes as long as to read a thousand short ones, which are limited in number."""
    stream: Any = _Stream()
    connection: Any = SimpleNamespace(receive_data=lambda _: [MessageReceived(Ping(1, 0))])
    handled: list[object] = []

    async def flood(channel: ControlChannel, seconds: float) -> int:
        """Send as much as is read; the bytes."""
        taken, until = 0, loop.time() + seconds
        while loop.time() < until:
            if not stream.paused:
                channel.received(bytes(_READ))
                taken += _READ
            await asyncio.sleep(_EVERY)
        return taken

    async def run() -> tuple[int, int]:
        channel = ControlChannel(stream, connection, Handlers(handled.append), lambda *_: None)
        return await flood(channel, _SECONDS), await flood(channel, _SECONDS)

    first, then = loop.run_until_complete(run())
    assert first <= (_SECONDS + 8) << 20
    assert (_SECONDS - 2) << 20 <= then <= (_SECONDS + 2) << 20
    assert len(handled) == (first + then) // _READ


def test_a_peer_whose_messages_wait_here_is_not_silent(loop: VirtualLoop) -> None:
    """More of them came at once than are handled in the time after which a silent peer is given up."""
    stream: Any = _Stream()
    connection: Any = SimpleNamespace(receive_data=lambda _: [MessageReceived(Ping(1, 0))] * 8000)
    handled: list[object] = []

    async def run() -> None:
        channel = ControlChannel(stream, connection, Handlers(handled.append), lambda *_: None)
        channel.received(b"all of them")
        while len(handled) < 8000:
            assert stream.paused
            loop.jump(0.1)
            channel._go_on()
            assert stream.received_at == loop.time()
        assert not stream.paused

    loop.run_until_complete(run())
