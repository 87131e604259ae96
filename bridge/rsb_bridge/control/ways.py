"""How a console comes to an engine: through the control socket of this machine, or sealed over a network."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.control.control_sockets import try_connect

if TYPE_CHECKING:
    from pathlib import Path

_BUSY_TRIED_EVERY = 0.05
_READ_SIZE = 256 << 10


class Connection(Protocol):
    """A console's end of a connection; belongs to one event loop."""

    async def read(self) -> bytes:
        """What has come; empty: the connection has ended.

        Raises:
            ControlError: it was ended, and this is why.
            OSError: it broke.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send, or keep until that is possible. After the end, nothing happens."""
        ...

    def abort(self) -> None:
        """Close, and forget what waits."""
        ...


class Way(Protocol):
    """Leads to one engine, again and again."""

    @property
    def same_machine(self) -> bool:
        """Whether the engine is on this machine: its files are this machine's files."""
        ...

    @property
    def text(self) -> str:
        """Names the engine where nothing is known of it yet, at the beginning of a message."""
        ...

    async def open(self, within: float) -> Connection:
        """Connect; whatever ends this, nothing is left open.

        Args:
            within: s in which it has to answer.

        Raises:
            ControlError: it cannot be, and this is why.
            OSError: likewise.
            TimeoutError: it does not answer.
        """
        ...


class UnixSocket:
    """The control socket of an engine on this machine.

    Args:
        path: of the socket.
    """

    same_machine = True

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def text(self) -> str:
        return str(self.path)

    async def open(self, within: float) -> Connection:
        """Connect.

        The socket is made between two awaits, so that a cancellation cannot come before somebody owns it.
        """
        async with asyncio.timeout(within):
            while (connection := try_connect(self.path)) is None:  # noqa: ASYNC110 — the kernel tells of no event
                await asyncio.sleep(_BUSY_TRIED_EVERY)
        try:
            return _Stream(*await asyncio.open_unix_connection(sock=connection))
        except BaseException:
            connection.close()
            raise


class _Stream:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    async def read(self) -> bytes:
        return await self._reader.read(_READ_SIZE)

    def write(self, data: bytes) -> None:
        if not self._writer.is_closing():
            self._writer.write(data)

    def abort(self) -> None:
        self._writer.transport.abort()
