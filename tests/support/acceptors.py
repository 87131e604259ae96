"""A server that takes the streams and datagrams of a listening transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.transport.streams import StreamHandler

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.transport.transport import Datagrams, DatagramSocket


def _ignore(_: str) -> None:
    """Tell nobody."""


def _drop(_: DatagramSocket, __: Datagrams) -> None:
    """Take nothing."""


@dataclass
class Accepting:
    """An `Acceptor` whose server has functions for what a test wants to see."""

    make_handler: Callable[[], StreamHandler] = StreamHandler
    datagrams: Callable[[DatagramSocket, Datagrams], None] = _drop
    shortage: Callable[[str], None] = _ignore
    others: Callable[[str], None] = _ignore

    async def prove(self, hosts: list[str]) -> list[str]:
        return []
