"""The interfaces between a route and its channel."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.reason import Reason
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.wire.framing import Message
REOPENS = "the link opens its data connection again"


class RouteSink(Protocol):
    """The route whose messages a channel carries, as far as the channel knows it."""

    @property
    def id(self) -> int:
        """Route id of the present incarnation."""

    @property
    def outgoing(self) -> bool:
        """Whether this side sends."""

    @property
    def duplex(self) -> bool:
        """Whether both sides send."""

    @property
    def weight(self) -> int:
        """The weight of its share of the link."""

    @property
    def resumes(self) -> bool:
        """Whether it stays open when its stream is lost, and goes on on the next one."""

    def deliver(self, messages: Iterable[Message]) -> None:
        """Take messages that arrived whole and authentic."""

    def flush(self) -> None:
        """Send from the queue: the channel takes messages again."""

    def channel_lost(self, reason: Reason) -> None:
        """Handle the failure of the channel, which is closed already."""


class Counts(NamedTuple):
    """Messages that a channel received in part or not at all.

    Attributes:
        newest: number of the newest message seen, from 1, or None on a stream, where none is overtaken.
        lost: messages that were lost with a stream.
        incomplete: messages that wait for some of their fragments.
        expired: messages given up because fragments did not come in time.
    """

    newest: int | None = 0
    incomplete: int = 0
    expired: int = 0
    lost: int = 0


class DataChannel(Protocol):
    """Carries the messages of one incarnation of a route."""

    @property
    def ready(self) -> bool:
        """Whether messages get through."""

    def trouble(self) -> Verdict | None:
        """Return the verdict on a channel over which nothing gets through now, or None."""

    def close(self, reason: str) -> None:
        """Free it. The route hears no more of it."""


class SendingChannel(DataChannel, Protocol):
    """The sending end of a channel."""

    @property
    def congested(self) -> bool:
        """Whether messages have to wait now: then `ask`."""

    @property
    def free(self) -> bool:
        """Whether it accepts messages now or in a round trip or two."""

    def ask(self) -> None:
        """Have `RouteSink.flush` called once messages may be sent. Calling it again while they wait changes nothing."""

    def takes(self, size: int) -> bool:
        """Whether messages of `size` bytes together may be sent now, past the queue."""

    @property
    def batch_bytes(self) -> int:
        """Bytes to send at once; a single message may be longer."""

    def send(self, batch: Sequence[Message]) -> None:
        """Send messages, oldest first."""

    @property
    def moves(self) -> bool:
        """Whether what it sends on delivers."""

    def datagrams(self, size: int) -> int:
        """Return how many datagrams a message of `size` bytes takes now, or 0 on a stream; only once it is ready."""

    def still(self, now: float) -> float:
        """Return for how long (s) no receipt has come on the link, at `now` (s)."""

    def behind(self, now: float) -> bool:
        """Whether its turns have not been enough for a second, at `now` (s)."""

    @property
    def unheard_for(self) -> float:
        """Seconds since a receipt told of further datagrams; infinite before the first, and on a stream."""


class ReceivingChannel(DataChannel, Protocol):
    """The receiving end of a channel."""

    def counts(self) -> Counts:
        """Counts of missing messages."""


class DuplexChannel(SendingChannel, ReceivingChannel, Protocol):
    """An end of a channel that carries messages both ways."""
