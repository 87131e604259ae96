"""What one peer may have this side hold, over all its routes."""

from __future__ import annotations


class Budget:
    """Bytes that several holders may hold together. Each gives back what it took.

    Attributes:
        limit: the most, bytes.
        held: now, bytes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.held = 0

    def take(self, size: int) -> bool:
        """Hold `size` bytes more; False: they would be too many, and none was taken."""
        if self.held + size > self.limit:
            return False
        self.held += size
        return True

    def give(self, size: int) -> None:
        """Hold `size` bytes less."""
        self.held -= size
