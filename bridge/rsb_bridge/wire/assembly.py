"""A message that comes in chunks, opened into its place."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from rsb_bridge.wire.budget import Budget
    from rsb_bridge.wire.sealing import Buffer, StreamOpener


class Assembly:
    """One route's. Memory is taken for as much as the last message had, as most topics' messages are alike.

    Attributes:
        begun: more chunks of a message follow.
        held: bytes of the budget.
    """

    def __init__(self, opener: StreamOpener, limit: int, budget: Budget) -> None:
        """Begin.

        Args:
            opener: opens the chunks.
            limit: bytes of the longest message.
            budget: for what has been taken of memory.
        """
        self.begun = False
        self.held = 0
        self._open_into = opener.open_into
        self._tag = opener.suite.tag_length
        self._limit = limit
        self._budget = budget
        self._content = io.BytesIO()  # gives its content away without a copy
        self._size = 0
        self._expected = 0

    def add(self, sealed: Buffer, header: Buffer) -> None:
        """Open the next chunk.

        Raises:
            ProtocolError: the message is too long, or the budget is spent.
            SealError: the seal is invalid.
        """
        at = self._size
        end = at + max(0, len(sealed) - self._tag)
        if end > self._limit:
            raise ProtocolError(f"a message of more than {self._limit} bytes in chunks")
        if end > self.held:
            self._grow(end)
        with self._content.getbuffer() as whole, whole[at:end] as place:
            self._open_into(sealed, header, place)
        self.begun = True
        self._size = end

    def take(self) -> bytes:
        """The message, which is whole."""
        self._expected = self._size
        self._content.truncate(self._size)
        content = self._content.getvalue()
        self.close()
        return content

    def close(self) -> None:
        """Discard the message."""
        self._budget.give(self.held)
        self.begun = False
        self.held = self._size = 0
        self._content = io.BytesIO()

    def _grow(self, needed: int) -> None:
        """Have room for `needed` bytes, and for more where the budget has it: each time costs a copy."""
        generous = min(max(self._expected, 2 * self.held, needed), self._limit)
        if self._budget.take(generous - self.held):
            self.held = generous
        else:
            hold(self._budget, needed - self.held)
            self.held = needed
        self._content.seek(self.held - 1)
        self._content.write(b"\0")


def hold(budget: Budget, size: int) -> None:
    """Take bytes of incomplete messages from a budget.

    Raises:
        ProtocolError: it is spent.
    """
    if not budget.take(size):
        raise ProtocolError(f"the link's incomplete messages would take more than {budget.limit:,} bytes")
