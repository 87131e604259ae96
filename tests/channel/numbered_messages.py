"""Numbered messages of routes, and streams that are opened again."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING

from tests.channel.sides import by_sockets

from rsb_bridge.model.reason import EndCode, Reason

if TYPE_CHECKING:
    from tests.channel.sides import Side

    from rsb_bridge.channel.data_stream import DataStream

CUT = Reason("cut", EndCode.BROKE)
_NUMBERS = count(3)


class Numbers:
    """Numbered messages of one route.

    Args:
        size: bytes of each.
    """

    def __init__(self, side: Side, route: int, size: int) -> None:
        self._near, self._far, self._size = side.routes[route], side.other.routes[route], size
        self.sent = 0

    def send(self, count: int) -> None:
        for number in range(self.sent, self.sent + count):
            self._near.send(number.to_bytes(4) + bytes(self._size - 4))
        self.sent += count

    @property
    def arrived(self) -> list[int]:
        return [int.from_bytes(payload[:4]) for payload in self._far.payloads]

    @property
    def counted(self) -> int:
        """Messages that came, or that the receiving end counts as lost."""
        return len(self.arrived) + int(self._far.channel.counts().lost)

    def all_known(self) -> bool:
        assert not self._near.lost, "no more will come"
        return bool(self.arrived) and self.arrived[-1] == self.sent - 1


async def reopen(*sides: Side, names: tuple[str, ...] = ("small", "large")) -> None:
    """Open streams of these names between both sides, as a client does."""
    for name in names:
        number, ends = next(_NUMBERS), await by_sockets()
        for side, stream in zip(sides, ends, strict=True):
            side.pair.lose(stream_of(side, name), Reason("replaced", EndCode.BROKE))
            stream.handler = side.pair.add(stream, number, small=name == "small", large=name == "large")
            side.pair.resume_routes()


def stream_of(side: Side, name: str) -> DataStream:
    found = getattr(side.pair, name)
    assert found is not None
    return found  # type: ignore[no-any-return]
