"""Connections from a console to an engine: over the control socket of this machine, or sealed over a network."""

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
        """Return the next bytes, or nothing if the connection has ended.

        Raises:
            ControlError: the engine or this side ended it; the message has the reason.
            OSError: it broke.
        """

    def write(self, data: bytes) -> None:
        """Send, or keep until that is possible. After the end, nothing happens."""

    def abort(self) -> None:
        """Close, and forget what waits."""


class Connector(Protocol):
    """Connects to one engine, any number of times."""

    @property
    def same_machine(self) -> bool:
        """Whether the engine is on this machine: its files are this machine's files."""

    @property
    def text(self) -> str:
        """The name of the engine for messages, until the engine itself has given one."""

    async def open(self, within: float) -> Connection:
        """Connect. Nothing is left open if this fails or is cancelled.

        Args:
            within: s in which the engine has to answer.

        Raises:
            ControlError: there is no connection; the message has the reason.
            OSError: the same.
            TimeoutError: the engine does not answer.
        """


class UnixSocket:
    """The control socket of an engine on this machine."""

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
