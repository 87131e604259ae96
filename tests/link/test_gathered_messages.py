"""Control messages of one turn of the loop: they leave in one write where they are gathered."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.simulation.beds import Yard

from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.model.session import Topic
from rsb_bridge.transport.streams import Stream
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.messages import Ping, Report, Shutdown

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

PING, REPORT = Ping(n=1, sent=1), Report()


class Written:
    """A stream that keeps what is written.

    Attributes:
        writes: each of them.
    """

    def __init__(self) -> None:
        self.handler: Any = None
        self.congested = False
        self.received_at = 0.0
        self.writes: list[bytes] = []
        self.write, self.close = self.writes.append, lambda _: None


def gathering(act: Callable[[ControlChannel, Written], object]) -> Written:
    """Return the stream of a channel that gathers, after a turn of the loop in which something is done with it."""
    stream: Any = Written()

    async def main() -> None:
        connection: Any = SimpleNamespace(send_encoded=lambda content: content)
        channel = ControlChannel(stream, connection, {}, lambda *_: None, lambda _: None)
        channel.gather(lambda: PING)
        act(channel, stream)
        await asyncio.sleep(0)
        channel.send(REPORT)

    asyncio.run(main())
    written: Written = stream
    return written


def test_messages_of_turn_leave_together_behind_ping() -> None:
    def report(channel: ControlChannel, _: Written) -> None:
        channel.send(REPORT)
        channel.send(REPORT)

    assert gathering(report).writes == [encode(PING) + 2 * encode(REPORT), encode(REPORT)]


def test_gathered_messages_leave_before_goodbye() -> None:
    def leave(channel: ControlChannel, _: Written) -> None:
        channel.send(REPORT)
        channel.shut_down("the end", retry_after=None)

    writes = gathering(leave).writes
    assert writes[:2] == [encode(REPORT), encode(Shutdown("the end", retry_after=None))]
    assert encode(PING) not in writes


def test_gathered_messages_wait_for_congested_stream() -> None:
    def report(channel: ControlChannel, stream: Written) -> None:
        channel.send(REPORT)
        stream.congested = True

    stream = gathering(report)
    assert not stream.writes
    stream.handler.writable()
    assert stream.writes == [encode(PING) + 2 * encode(REPORT)]


def test_regular_messages_of_link_take_two_writes_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ping with receipts and a report, and the answer to the other side's ping."""
    yard = Yard(Topic("/chat", "transmit"))
    (writer,) = yard.publish("/chat")
    writes: list[Stream] = []
    write = Stream.write

    def counting(self: Stream, data: bytes | memoryview) -> None:
        writes.append(self)
        write(self, data)

    async def live() -> None:
        for seconds in range(40):
            if seconds == 20:
                monkeypatch.setattr(Stream, "write", counting)
            writer.publish(b"\0\1\0\0\3\0\0\0go\0")
            await asyncio.sleep(1.0)
        for on_server in (False, True):
            control = yard.link(on_server=on_server).channels.control.stream
            assert sum(each is control for each in writes) <= 2 * 20 + 4

    yard.world.invariants.check = lambda: None  # type: ignore[method-assign]  # it counts the world's own flows
    yard.world.play(life=yard.live(live()))
