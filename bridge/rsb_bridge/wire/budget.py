"""A limit on the memory that one peer can make this side hold, over all its routes."""

from __future__ import annotations


class Budget:
    """Bytes that several holders share. Each gives back what it took.

    Attributes:
        limit: bytes.
        held: bytes, now.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.held = 0

    def take(self, size: int) -> bool:
        """Take `size` bytes; False: that would exceed the limit, and nothing was taken."""
        if self.held + size > self.limit:
            return False
        self.held += size
        return True

    def give(self, size: int) -> None:
        """Give back `size` bytes."""
        self.held -= size
