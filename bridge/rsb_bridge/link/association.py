"""The part of a link that outlives its connections: channels, and control messages that the peer has not handled.

Two processes that have linked share an association (PROTOCOL.md, 1.7). It suspends when a connection
breaks: routes, their ids, endpoints and queues stay, and control messages wait. It resumes on the next connection where
both sides were: each says how many messages it has handled, and the other sends the rest again.
"""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import ConnectionMessage, Propose
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.data_channels import DataChannels
    from rsb_bridge.wire.events import Established
    from rsb_bridge.wire.messages import ControlMessageBase, Hello

MOST_KEPT, MOST_BYTES = 16_384, 8 * CONTROL_LIMIT
"""Control messages that wait, and their bytes: a thousand routes are opened with some four thousand. Round figures."""
NEVER_HANDLED = "the peer takes control messages and handles none: more wait than it may have"


class UnhandledMessage(NamedTuple):
    """A control message that the peer may not have handled.

    Attributes:
        content: as it is encoded.
        proposes: the route that it proposes, or 0.
    """

    content: bytes
    proposes: int


class Association:
    """One side's part of an association. Messages about a connection itself, such as pings, do not count.

    Args:
        association_id: names it; that of the link's first connection.
        instance: of the peer's process.

    Attributes:
        channels: of the present connection, or of the last one while it is suspended.
        handled: messages of the peer that this side has handled to their end.
        acknowledged: messages of this side that the peer has said it has handled.
        is_over: whether more waited than may: it ends with its connection, which ends, too.
    """

    def __init__(self, association_id: bytes, instance: str, channels: DataChannels) -> None:
        self.id = association_id
        self._instance = instance
        self.channels = channels
        self.handled = 0
        self.is_over = False
        self.acknowledged = 0
        self._waiting: deque[UnhandledMessage] = deque()
        self._bytes = 0  # of these
        self._ends: asyncio.TimerHandle | None = None

    # --- its connections

    def may_resume(self, hello: Hello) -> bool:
        """Whether a client may resume it: it is the same process, and nothing is missing."""
        known = (hello.association, hello.instance) == (self.id, self._instance)
        return known and self._could_go_on_from(hello.handled)

    def resumes(self, event: Established) -> bool:
        """Whether both sides resume it on a new connection."""
        return (event.answer or event.peer).association == self.id

    def could_resume(self, event: Established) -> bool:
        """Whether the server's answer begins another association, or resumes this one where it is by now."""
        return not self.resumes(event) or self._could_go_on_from(event.peer.handled)

    def suspend(self, reason: str, ends: asyncio.TimerHandle) -> None:
        """Wait for another connection until the timer ends the association."""
        self._ends = ends
        self.channels.suspend(reason)

    def resume(self, control: ControlChannel, event: Established) -> Sequence[UnhandledMessage]:
        """Resume on another connection, and return what the peer lacks."""
        self._stop_waiting()
        self.channels.resume(control, event.keys, [each.proposes for each in self._waiting if each.proposes])
        return tuple(self._waiting)  # with what has been sent since the line before began

    def end(self) -> None:
        self._stop_waiting()
        self.channels.close()

    @property
    def ends_at(self) -> float | None:
        """When it ends unless a connection comes, in s on the loop's clock, or None while it has one."""
        return None if self._ends is None else self._ends.when()

    def _stop_waiting(self) -> None:
        if self._ends is not None:
            self._ends.cancel()
            self._ends = None

    # --- control messages

    def sends(self, message: ControlMessageBase, content: bytes) -> None:
        """Keep a message, which is being sent or waits for a connection, until the peer has handled it.

        Args:
            content: the message as it is encoded.
        """
        if self.is_over or isinstance(message, ConnectionMessage):
            return
        self._waiting.append(UnhandledMessage(content, message.route if isinstance(message, Propose) else 0))
        self._bytes += len(content)
        if len(self._waiting) > MOST_KEPT or self._bytes > MOST_BYTES:
            self.is_over = True
            self._waiting.clear()

    def handles(self, message_type: type[ControlMessageBase]) -> None:
        """Count a message of the peer, which has been handled."""
        if not issubclass(message_type, ConnectionMessage):
            self.handled += 1

    def could_have_handled(self, count: int) -> bool:
        """Whether a peer may have handled the first `count` messages, and no message that it lacks is gone."""
        return not self.is_over and 0 <= count - self.acknowledged <= len(self._waiting)

    def _could_go_on_from(self, count: int) -> bool:
        """Whether a peer may resume that has handled the first `count` messages: it has used no later proposal."""
        if not self.could_have_handled(count):
            return False
        lacking = islice(self._waiting, count - self.acknowledged, None)
        return not any(each.proposes and self.channels.is_accepted(each.proposes) for each in lacking)

    def take_up(self, count: int) -> None:
        """Forget the first `count` messages, as the peer resumes.

        Raises:
            ProtocolError: as `acknowledge`; or the peer has used a proposal that it says it lacks, whose keys on the
                next connection would be others on each side.
        """
        if not self.is_over and not self._could_go_on_from(count):
            raise self._wrong(count)
        self.acknowledge(count)

    def acknowledge(self, count: int) -> None:
        """Forget the first `count` messages of the association.

        Raises:
            ProtocolError: fewer were sent, or more were acknowledged before.
        """
        if self.is_over:
            return
        if not self.could_have_handled(count):
            raise self._wrong(count)
        for _ in range(count - self.acknowledged):
            self._bytes -= len(self._waiting.popleft().content)
        self.acknowledged = count

    def _wrong(self, count: int) -> ProtocolError:
        sent = self.acknowledged + len(self._waiting)
        return ProtocolError(Broken.HANDLED_WRONG(count=count, sent=sent, acknowledged=self.acknowledged))
