"""Long control messages of one peer: the others wait for one slice of work only."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from msgspec import inspect
from tests.support import constants
from tests.support.bridge import linked
from tests.support.rogue import Rogue
from tests.support.slices import Handlers
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.control_channel import BYTES, ENTRIES, ControlChannel, entries_in_slices
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.model.qos import Qos
from rsb_bridge.wire.codec import (
    WHOLE,
    ReportParts,
    control_messages,
    decode,
    encode,
    report_entries,
)
from rsb_bridge.wire.events import MessageReceived
from rsb_bridge.wire.messages import Describe, Ping, Report
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import CallsReport, ReceivedReport, SentCounts, Source

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.virtual_time import VirtualLoop

DROPPED = {f"cause_{number:04}": number for number in range(32)}


def long_report(entries: int = ROUTES_PER_LINK) -> Report:
    """A report of some 400 kB, and the last entry of which is another one."""
    last = SentCounts(route=1, offered=12345, delivered=12345)
    return Report(sent_counts=(SentCounts(route=1, dropped=DROPPED),) * (entries - 1) + (last,))


class Stream:
    """A stream that may be paused."""

    handler: Any = None
    congested = paused = False
    received_at = 0.0
    aborted = ""

    def pause_reading(self) -> None:
        self.paused = True

    def resume_reading(self) -> None:
        self.paused = False

    def abort(self, reason: str) -> None:
        self.aborted = reason


class Peer:
    """A control connection, whose handler counts what is done at each turn of the loop."""

    def __init__(self, events: list[Any], sliced: Callable[[Any, Callable[[object], None]], Any]) -> None:
        self.stream: Any = Stream()
        self.done: list[object] = []
        self.most = 0
        """Entries or messages at one turn."""
        self._events = events
        self._sliced = sliced

    def message(self, message: object) -> Any:
        if isinstance(message, Report | ReportParts):
            return self._sliced(message, self.done.append)
        self.done.append(message)
        return None

    def run(self, until: int) -> None:
        """Have all events come at once, and turn until so much is done."""

        async def main() -> None:
            connection: Any = SimpleNamespace(receive_data=lambda _: self._events)
            channel = ControlChannel(self.stream, connection, Handlers(self.message), lambda *_: None, lambda _: None)
            channel.received(b"x")
            before = 0
            while True:
                self.most = max(self.most, len(self.done) - before)
                if len(self.done) >= until or channel.over:
                    return
                assert self.stream.paused, "the rest waits in the network"
                before = len(self.done)
                await asyncio.sleep(0)

        asyncio.run(asyncio.wait_for(main(), 60.0))


def entries_of(message: Any, done: Callable[[object], None]) -> Any:
    return entries_in_slices(report_entries(message), done)


def test_report_of_400_kb_is_read_in_slices() -> None:
    data = encode(long_report())
    assert 380_000 < len(data) < 420_000
    ping = Ping(1, 0)
    peer = Peer([MessageReceived(encode(ping)), MessageReceived(data), MessageReceived(encode(ping))], entries_of)
    peer.run(ROUTES_PER_LINK + 2)
    size = len(msgspec.msgpack.encode(SentCounts(route=1, dropped=DROPPED)))
    assert peer.most <= BYTES // size + 3
    assert peer.done == [ping, *long_report().sent_counts, ping]
    assert not peer.stream.paused


@pytest.mark.parametrize(
    "message",
    [
        Report(received=(ReceivedReport(route=1),) * ROUTES_PER_LINK),
        Report(calls=(CallsReport(route=1),) * 500),
    ],
)
def test_short_entries_are_worked_off_by_number(message: Any) -> None:
    entries = [*message.sent_counts, *message.received, *message.calls]
    peer = Peer([MessageReceived(encode(message))], entries_of)
    peer.run(len(entries))
    assert peer.done == entries
    assert peer.most <= 2 * ENTRIES  # a message's first slice, and those before it


def test_long_messages_take_one_turn_each() -> None:
    sources = tuple(Source((f"rsb_a/{number}",)) for number in range(16))
    for message in (Describe(1, "a/msg/B", "", Qos(depth=1), sources), Ping(1, 0)):
        peer = Peer([MessageReceived(encode(message))] * 100, entries_of)
        peer.run(100)
        assert peer.most <= (1 if isinstance(message, Describe) else 8)
    report = encode(Report(sent_counts=(SentCounts(route=1, dropped=DROPPED),) * 18))
    assert WHOLE - 1000 < len(report) <= WHOLE
    peer = Peer([MessageReceived(report)] * 20, entries_of)
    peer.run(20 * 18)
    assert peer.most <= 2 * 18


def receives(messages: list[Any], handle: Callable[[Any], Any]) -> tuple[ControlChannel, Any]:
    """A control connection on which these messages come with any bytes, and its stream."""
    stream: Any = Stream()
    connection: Any = SimpleNamespace(receive_data=lambda _: [MessageReceived(encode(each)) for each in messages])
    return ControlChannel(stream, connection, Handlers(handle), lambda *_: None, lambda _: None), stream


async def flood(channel: ControlChannel, size: int, every: float, seconds: float) -> int:
    """Send bytes as fast as they are read; how often."""
    loop = asyncio.get_running_loop()
    count, until = 0, loop.time() + seconds
    while loop.time() < until:
        if not channel.stream.paused:  # type: ignore[attr-defined]
            channel.received(bytes(size))
            count += 1
        await asyncio.sleep(every)
    return count


@pytest.mark.parametrize("entries", [500, 63])
async def test_entries_come_no_faster_than_thousand_routes_report(loop: VirtualLoop, entries: int) -> None:
    done: list[object] = []
    report = Report(sent_counts=(SentCounts(route=1),) * entries)
    channel, _ = receives([report], lambda each: entries_of(each, done.append))
    every = 0.002 if entries < ENTRIES else 0.01
    burst, rate = 40_000, 10_000  # docs/budgets.md
    for room in (burst, 0):
        done.clear()
        await flood(channel, 9 * entries, every, 10.0)
        assert len(done) <= room + 10 * rate + 3 * ENTRIES


async def test_long_messages_are_taken_in_slowly(loop: VirtualLoop) -> None:
    """To read 1 MB of a control message takes as long as to read a thousand short ones, which are limited in number."""
    handled: list[object] = []
    channel, _ = receives([Ping(1, 0)], handled.append)
    first, then = [await flood(channel, 1 << 18, 0.01, 60) for _ in range(2)]
    assert first <= (60 + 8) * 4
    assert (60 - 2) * 4 <= then <= (60 + 2) * 4
    assert len(handled) == first + then


async def test_peer_whose_messages_wait_here_is_not_silent(loop: VirtualLoop) -> None:
    """More of them came at once than are handled in the time after which a silent peer is given up."""
    handled: list[object] = []
    channel, stream = receives([Ping(1, 0)] * 8000, handled.append)
    channel.received(b"all of them")
    while len(handled) < 8000:
        assert stream.paused
        loop.jump(0.1)
        channel._go_on()
        assert stream.received_at == loop.time()
    assert not stream.paused


async def test_ended_connection_handles_nothing(loop: VirtualLoop) -> None:
    handled: list[object] = []
    channel, _ = receives([], handled.append)
    channel.broken("a wrong number in the handshake")
    channel.receive([MessageReceived(encode(Ping(1, 0)))])
    assert not handled


def test_reported_routes_have_limit_of_link() -> None:
    decode(encode(long_report()))
    with pytest.raises(ProtocolError):
        decode(encode(long_report(ROUTES_PER_LINK + 1)))


def test_an_entry_that_is_invalid_ends_the_connection() -> None:
    wrong = msgspec.to_builtins(long_report())
    wrong["sent_counts"] = (*wrong["sent_counts"][:-1], (0,))
    peer = Peer([MessageReceived(msgspec.msgpack.encode({"message": "report", **wrong}))], entries_of)
    peer.run(ROUTES_PER_LINK)
    assert peer.stream.aborted
    assert len(peer.done) == ROUTES_PER_LINK - 1
    broken = Peer([MessageReceived(b"\xc1")], entries_of)
    broken.run(1)
    assert broken.stream.aborted


def unbounded(kind: inspect.Type, where: str) -> list[str]:
    """Return the fields of a message that may have any number of entries, or a text of any length."""
    match kind:
        case inspect.StrType() | inspect.BytesType() | inspect.VarTupleType() | inspect.ListType() | inspect.DictType():
            found = [] if kind.max_length is not None else [where]
        case _:
            found = []
    inner = [getattr(kind, name) for name in ("item_type", "key_type", "value_type") if hasattr(kind, name)]
    inner += [*getattr(kind, "types", ()), *getattr(kind, "item_types", ())]
    found += [each for one in inner for each in unbounded(one, where)]
    if isinstance(kind, inspect.StructType):
        found += [each for field in kind.fields for each in unbounded(field.type, f"{where}.{field.name}")]
    return found


def test_all_other_lists_in_control_messages_are_short() -> None:
    """A new list needs a limit, or parts of its own (`rsb_bridge.wire.codec`)."""
    found = {each for kind in control_messages() for each in unbounded(inspect.type_info(kind), kind.__name__)}
    assert found == {"Report.sent", "Report.received", "Report.calls", "Report.sent_counts", "Report.received_counts"}


def test_real_link_takes_whole_of_long_report(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 600.0)  # the rogue may say nothing for a while
    server = bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        route = rogue.route("/long", "tcp", Qos())
        report = long_report()
        entries = tuple(msgspec.structs.replace(entry, route=route) for entry in report.sent_counts)
        rogue.say(Report(sent_counts=entries))
        eventually(lambda: [each.ledger.offered for each in server.snapshot().routes] == [12345])
        assert linked(server)
        rogue.say(msgspec.structs.replace(report, sent_counts=entries * 2))
        eventually(lambda: any(event.code == EventCode.LINK_LOST for event in server.events()))
