"""The sending end of a route's channel, which takes turns with the other routes of its link."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.channel.channel import Pace

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.scheduler import Carrier, Scheduler
    from rsb_bridge.wire.framing import Message


class SendingEnd:
    """The part that does not depend on what carries the messages.

    Args:
        via: what carries them first.

    Attributes:
        start: virtual time at which its next turn begins.
    """

    via: Carrier

    def __init__(self, scheduler: Scheduler, route: RouteSink, via: Carrier) -> None:
        self.start = 0
        self.queued = False
        self.via = via
        self._scheduler = scheduler
        self._route = route
        self._messages: deque[Message] = deque()  # of the present turn, or of a large message's further ones
        self._asked = False  # more waits in the route's queue
        self._in_turn = False

    @property
    def rank(self) -> int:
        """The rank of its priority."""
        return self._route.rank

    @property
    def congested(self) -> bool:
        """See `rsb_bridge.channel.channel.SendingChannel`, and so for the other members of that protocol."""
        # In its turn a route gives one batch: the rest stays in its queue, where newer messages replace it.
        if self._in_turn:
            return bool(self._messages)
        return self.queued or bool(self._messages) or not self._scheduler.is_free(self.via)

    @property
    def batch_bytes(self) -> int:
        """Bytes to send at once."""
        return self._scheduler.chunk

    @property
    def waits(self) -> bool:
        """Whether it has more to send after a turn."""
        return self._asked or bool(self._messages)

    @property
    def pace(self) -> Pace:
        """State of the channel now."""
        scheduler = self._scheduler
        if not self.congested:
            return Pace.FREE
        if scheduler.grows:  # what waits in the kernel alone is no sign of an overload: the path may have stalled
            return Pace.STOPPED if self.via.congested else Pace.FREE
        return Pace.SLOW if scheduler.moves else Pace.STOPPED

    @property
    def grows(self) -> bool:
        """Whether the link's window still grows."""
        return self._scheduler.grows

    def datagrams(self, size: int) -> int:
        return 0

    @property
    def unheard_for(self) -> float:
        return math.inf

    def ask(self) -> None:
        """Wait for a turn with what the route's queue holds."""
        self._asked = True
        if not self._in_turn:
            self._scheduler.join(self)
            self._scheduler.run()

    def _wait(self, batch: Sequence[Message]) -> None:
        """Wait for a turn with messages that the queue has given already."""
        self._messages += batch
        self._scheduler.join(self)
        self._scheduler.run()

    def _fill(self) -> bool:
        """Take messages from the route's queue for this turn; return whether there are any."""
        self._asked, self._in_turn = False, True
        try:
            self._route.flush()
        finally:
            self._in_turn = False
        if self._messages:
            return True
        self._asked = False  # a route that asks and gives nothing would get turns without end
        return False

    def take_turn(self, limit: int) -> bytes | memoryview | int:
        """See `rsb_bridge.channel.scheduler.Turns`."""
        raise NotImplementedError

    def leave(self) -> None:
        """Take no more turns."""
        self._messages.clear()
        self._asked = False
        self._scheduler.leave(self)
