"""Writes to streams that leave together: what the messages of one turn write to a stream is one call of the kernel.

The other side is woken once for it, and reads it at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.transport.streams import Stream

_MOST = 64 * 1024  # bytes that are held of a stream: more fills a packet of the kernel's anyway (GSO, 64 KiB)


class JoinedWrites:
    """Holds writes while it is open. Belongs to the I/O loop.

    Attributes:
        is_open: whether streams hand over what they are to write.
    """

    def __init__(self) -> None:
        self.is_open = False
        self._held: dict[Stream, bytearray] = {}

    def hold(self, stream: Stream, data: bytes | memoryview) -> None:
        """Hold what is written to a stream."""
        held = self._held.get(stream)
        if held is None:
            held = self._held[stream] = bytearray()
        held += data
        if len(held) >= _MOST:
            self.send(stream)

    def send(self, stream: Stream) -> None:
        """Send what is held of a stream."""
        held = self._held.pop(stream, None)
        if held is not None:
            stream.send_held(held)

    def send_all(self) -> None:
        """Send all that is held."""
        while self._held:
            stream, held = self._held.popitem()
            stream.send_held(held)
