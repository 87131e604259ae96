"""Compressed messages on the receiving side: what they cost everyone else is bounded, at once and over time."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.wire.framing import HISTORY, MESSAGE_LIMIT, ZSTD
from rsb_bridge.wire.headers import split_history
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.wire.framing import Message

EXPANSION_AT_ONCE = 4 * MESSAGE_LIMIT
EXPANSION_A_SECOND = 256 << 20
"""Bytes that a link's compressed messages may have more here than on the wire: 64 MiB of zeros come as 2 kB, and to
unpack and publish them keeps the thread of all links busy for 60 ms."""
EXPANSION_A_TURN = 8 << 20
"""Bytes of that at each turn of the I/O loop, or one message: between two turns everyone else is served."""


class ExpansionBudget:
    """One link's.

    Attributes:
        over_time: bytes by which its compressed messages may grow here.
    """

    def __init__(self, now: float) -> None:
        self.over_time = TokenBucket(EXPANSION_AT_ONCE, EXPANSION_A_SECOND, now)
        self._this_turn = 0
        self._waiting: deque[Callable[[], None]] = deque()

    def begin(self, size: int, loop: asyncio.AbstractEventLoop) -> bool:
        """Whether a message that grows by `size` bytes may be unpacked at this turn of the loop; if so, it counts."""
        if self._this_turn and self._this_turn + size > EXPANSION_A_TURN:
            return False
        if not self._this_turn and size > 0:
            loop.call_soon(self._next_turn)
        self._this_turn += max(0, size)
        return True

    def wait(self, work: Callable[[], None]) -> None:
        """Have work done at a later turn, after all that waits already. `begin` was refused at this one."""
        self._waiting.append(work)

    def _next_turn(self) -> None:
        self._this_turn = 0
        for _ in range(len(self._waiting)):
            if self._this_turn >= EXPANSION_A_TURN:
                break
            self._waiting.popleft()()


class ExpandsTooMuchError(Exception):
    """A link's compressed messages grow too much over time."""

    def __init__(self) -> None:
        super().__init__(
            f"this link's compressed messages grow by more than {EXPANSION_A_SECOND:,} bytes a second here: "
            "send less, or without compression"
        )


class Unpacker:
    """Unpacks the compressed messages of one route.

    Args:
        budget: of its link.
        context: has the clock and the I/O loop.
    """

    def __init__(self, budget: ExpansionBudget, context: Context) -> None:
        self._budget = budget
        self._context = context
        self._decompressor = zstandard.ZstdDecompressor()

    def begin(self, message: Message) -> bool:
        """Whether a message may be published at this turn of the loop; those that will not be cost no turn."""
        payload, _, flags = message
        if not flags & ZSTD:
            return True
        try:
            growth = _growth(split_history(payload)[1] if flags & HISTORY else payload)
        except (ProtocolError, zstandard.ZstdError):
            return True
        if growth > self._budget.over_time.left(self._context.now()):
            return True
        return self._budget.begin(growth, self._context.loop)

    def unpack(self, payload: bytes) -> bytes:
        """A message's content.

        Raises:
            zstandard.ZstdError: it is damaged, or too long.
            ExpandsTooMuchError: it is too much by now.
        """
        if not self._budget.over_time.take(_growth(payload), self._context.now()):
            raise ExpandsTooMuchError
        return self._decompressor.decompress(payload)


def _growth(payload: bytes) -> int:
    size = zstandard.frame_content_size(payload)
    if not 0 <= size <= MESSAGE_LIMIT:
        raise zstandard.ZstdError(f"a compressed message claims {size:,} bytes")
    return size - len(payload)
