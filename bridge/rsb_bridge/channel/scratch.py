"""Memory in which large messages are sealed piece by piece, so that it stays in the processor's cache."""

from __future__ import annotations


class Scratch:
    """Memory that pieces are sealed into, one after another. A link's channels share it, on the I/O loop."""

    def __init__(self) -> None:
        self._memory = bytearray()

    def lend(self, size: int) -> bytearray:
        """Memory of at least that size, for as long as the caller does not return to the loop."""
        if len(self._memory) < size:
            self._memory = bytearray(size)
        return self._memory

    def lost(self) -> None:
        """Forget the lent memory, which its borrower still holds."""
        self._memory = bytearray()
