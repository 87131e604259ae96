"""Readers that take no more of a route than its meter allows: of the topics by which a peer measures the link."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.wire.datagram import DatagramReader
from rsb_bridge.wire.framing import DataReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.framing import Budget, Message
    from rsb_bridge.wire.sealing import Buffer, DatagramOpener, StreamOpener

Meter: TypeAlias = "Callable[[int], bool]"
"""Takes so many bytes, with their headers and seals, or returns False: then nothing more of the route is taken."""


class MeteredDataReader(DataReader):
    """Opens frames as long as the meter allows, and ignores all further ones; the meter ends the route."""

    def __init__(self, opener: StreamOpener, route: int, meter: Meter, budget: Budget) -> None:
        super().__init__(opener, route, budget=budget)
        self._meter = meter
        self._ended = False

    def receive_data(self, data: Buffer) -> list[Message]:
        if not self._takes(len(data)):
            return []
        open_frame = super().open_frame
        return [message for frame in self._frames.feed(data) if (message := open_frame(frame)) is not None]

    def open_frame(self, frame: Buffer) -> Message | None:
        return super().open_frame(frame) if self._takes(len(frame)) else None

    def _takes(self, size: int) -> bool:
        if not self._ended and not self._meter(size):
            self._ended = True
            self.close()
        return not self._ended


class MeteredDatagramReader(DatagramReader):
    """Opens datagrams as long as the meter allows. Forged datagrams are not counted."""

    def __init__(self, opener: DatagramOpener, route: int, meter: Meter, budget: Budget) -> None:
        super().__init__(opener, route, budget=budget)
        self._meter = meter
        self._ended = False

    def receive(self, datagram: Buffer, now: float) -> Message | None:
        if self._ended:
            return None
        opened = self.opened
        message = super().receive(datagram, now)
        if self.opened > opened and not self._meter(len(datagram)):
            self._ended = True
            self.close()
            return None
        return message
