"""The owner of a link's UDP channels where the link has no streams."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, cast

from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.window import ReceiptBook, Window

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.channel.udp_channel import PathProbe
    from rsb_bridge.wire.messages import Receipts


class LoneConnection:
    """The owner of UDP channels without streams, whose peer gets no receipts of any.

    Args:
        probe: may be None if there is no UDP channel.
        now: gives the time, or None for the running loop's.

    Attributes:
        ready: how often a channel has found its path.
        urgent: messages that came as datagrams.
    """

    def __init__(self, probe: PathProbe | None = None, now: Callable[[], float] | None = None) -> None:
        loop = asyncio.get_running_loop()
        self.probe = cast("PathProbe", probe)
        self.now = now or loop.time
        self.ready = 0
        self.urgent: list[bytes] = []
        self.book = ReceiptBook(loop, self)
        self.scheduler = Scheduler(self.book, Window())

    def udp_ready(self) -> None:
        self.ready += 1

    def take_urgent(self, content: bytes) -> None:
        self.urgent.append(content)

    def send_receipts(self, receipts: Receipts) -> None:
        """Send nothing."""

    def ping(self) -> float:
        return 0.0

    def way_back(self) -> float:
        return 0.0
