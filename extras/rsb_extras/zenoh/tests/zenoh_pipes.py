"""Two ends of a Zenoh stream with a network between that a test owns: no router, no thread, no time."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple, cast

from rsb_bridge.wire.sealing import SampleTags
from rsb_extras.zenoh.outbox import OWN_COST
from rsb_extras.zenoh.pipe import Pipe
from rsb_extras.zenoh.sample_header import Header, SampleKind

if TYPE_CHECKING:
    from rsb_extras.zenoh.endpoint import ZenohEndpoint

STREAM = "5" * 16
SECRET = bytes(range(32))


class Sent(NamedTuple):
    """One sample in flight."""

    header: Header
    payload: bytes


class FakeEndpoint:
    """The part of an endpoint that a pipe uses.

    Attributes:
        on_its_way: samples that were sent, and have not been carried to the other end.
        backlog: bytes that Zenoh has not been given yet.
        in_flight: as `rsb_extras.zenoh.outbox` counts it.
        end: the pipe; None once it is over.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.on_its_way: list[Sent] = []
        self.backlog = self.in_flight = 0
        self.end: Pipe | None = None
        self.outbox = self

    def key(self, to: str, stream: str) -> str:
        return f"{to}/{self.address}/{stream}"

    def add(self, peer: str, stream: str, end: Pipe) -> None:
        self.end = end

    def forget(self, peer: str, stream: str) -> None:
        self.end = None

    def trust(self, peer: str, stream: str) -> None:
        pass

    def put(self, key: str, payload: bytes, header: Header) -> None:
        self.on_its_way.append(Sent(header, bytes(payload)))
        if header.kind == SampleKind.DATA:
            self.in_flight += len(payload) + OWN_COST

    def arrived(self, rank: int, size: int) -> None:
        self.in_flight -= size

    def waiting(self, key: str, rank: int) -> int:
        return self.backlog


class Recorder(asyncio.Protocol):
    """Records its calls.

    Attributes:
        calls: names of the methods that were called, without those for data.
        pause_after: pause reading when so many pieces have come.
    """

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.pieces: list[bytes] = []
        self.error: Exception | None = None
        self.pause_after = 0
        self.transport: asyncio.Transport | None = None

    @property
    def data(self) -> bytes:
        return b"".join(self.pieces)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.Transport", transport)
        self.calls.append("made")

    def data_received(self, data: bytes) -> None:
        self.pieces.append(data)
        if len(self.pieces) == self.pause_after and self.transport is not None:
            self.transport.pause_reading()

    def eof_received(self) -> None:
        self.calls.append("eof")

    def pause_writing(self) -> None:
        self.calls.append("pause")

    def resume_writing(self) -> None:
        self.calls.append("resume")

    def connection_lost(self, error: Exception | None) -> None:
        self.error = error
        self.calls.append("lost")


class Side:
    def __init__(self, address: str, peer: str, *, stranger: bool = False) -> None:
        self.network = FakeEndpoint(address)
        self.told = Recorder()
        self.pipe = Pipe(cast("ZenohEndpoint", self.network), peer, STREAM, 1, self.told, stranger=stranger)
        self._tags: SampleTags | None = None

    def authenticate(self, *, opener: bool) -> None:
        """Tag what the pipe sends, and what `arrive` has come."""
        self.pipe.authenticate(SECRET, opener=opener)
        self._tags = SampleTags(SECRET, STREAM, opener=not opener)

    def arrive(self, kind: int, number: int, payload: bytes = b"") -> None:
        """Have a sample of the other side come."""
        tag = b"" if self._tags is None else self._tags.tag(kind, number, payload)
        self.pipe.arrived(Header(kind, 1, number, tag), payload)

    def forge(self, kind: int, number: int, payload: bytes = b"", tag: bytes = b"") -> None:
        """Have a stranger's sample come."""
        self.pipe.arrived(Header(kind, 1, number, tag), payload)

    def sent(self, kind: SampleKind) -> list[Sent]:
        """Return the samples in flight of a kind, without tags."""
        return [
            Sent(each.header._replace(tag=b""), each.payload)
            for each in self.network.on_its_way
            if each.header.kind == kind
        ]


class Pair:
    """Both ends. Nothing crosses until `carry`.

    Args:
        authenticated: both sides have proven their keys.
    """

    def __init__(self, *, authenticated: bool = True) -> None:
        self.near, self.far = Side("a" * 16, "b" * 16), Side("b" * 16, "a" * 16)
        if authenticated:
            self.near.authenticate(opener=True)
            self.far.authenticate(opener=False)

    def carry(self) -> bool:
        """Deliver the samples in flight of both sides. Return whether there were any."""
        moved = False
        for here, there in ((self.near, self.far), (self.far, self.near)):
            going, here.network.on_its_way = here.network.on_its_way, []
            for sample in going:
                if there.network.end is not None:
                    there.pipe.arrived(*sample)
                moved = True
        return moved

    async def settle(self) -> None:
        """Carry until nothing moves any more."""
        for _ in range(1000):
            moved = self.carry()
            await asyncio.sleep(0)
            if not moved:
                return
