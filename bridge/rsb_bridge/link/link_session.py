"""The control messages that one side of a link has sent and the other has not handled, across connections.

Two processes that have linked share a session (PROTOCOL.md, 1.7). When a connection breaks, the link is away: routes,
their ids, endpoints and queues stay, and control messages wait. The next connection goes on where both sides were: each
says how many messages it has handled, and the other sends the rest again.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.wire.messages import OF_CONNECTION
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.wire.messages import ControlMessageBase

MOST_KEPT = 16_384
"""Control messages that wait: a thousand routes are opened with some four thousand. A round figure."""


class LinkSession:
    """One side's part of a session. Messages about a connection itself, such as pings, do not count.

    Attributes:
        id: names it; that of the link's first connection.
        handled: messages of the peer that this side has handled to their end.
        full: whether more messages wait than may; then the session is over.
    """

    def __init__(self, session_id: bytes) -> None:
        self.id = session_id
        self.handled = 0
        self._acknowledged = 0
        self._waiting: deque[ControlMessageBase] = deque()

    @property
    def full(self) -> bool:
        return len(self._waiting) > MOST_KEPT

    def sends(self, message: ControlMessageBase) -> None:
        """Keep a message, which is being sent or waits for a connection, until the peer has handled it."""
        if not isinstance(message, OF_CONNECTION):
            self._waiting.append(message)

    def handles(self, message_type: type) -> None:
        """Count a message of the peer, which has been handled."""
        if not issubclass(message_type, OF_CONNECTION):
            self.handled += 1

    def acknowledge(self, count: int) -> None:
        """Forget the first `count` messages of the session.

        Raises:
            ProtocolError: fewer were sent, or more were acknowledged before.
        """
        if self.lacks(count) is None:
            raise ProtocolError(Broken.HANDLED_WRONG(count=count))
        for _ in range(count - self._acknowledged):
            self._waiting.popleft()
        self._acknowledged = count

    def lacks(self, count: int) -> int | None:
        """Return how many messages a peer lacks that has handled the first `count`, or None if that cannot be."""
        missing = self._acknowledged + len(self._waiting) - count
        return missing if 0 <= missing <= len(self._waiting) else None

    def again(self, count: int) -> Sequence[ControlMessageBase]:
        """Return what a peer lacks that has handled the first `count` messages; raises as `acknowledge`."""
        self.acknowledge(count)
        return tuple(self._waiting)
