"""The interface between a route and its channel; the sending end is `rsb_bridge.channel.scheduler.SendingChannel`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.fates import Fates
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
    def fates(self) -> Fates:
        """The effect of each loss on it (`rsb_bridge.model.fates`)."""

    def deliver(self, messages: Sequence[Message]) -> None:
        """Take messages that arrived whole and authentic."""

    def flush(self) -> None:
        """Send from the queue: the channel takes messages again."""

    def channel_lost(self, reason: Reason) -> None:
        """Handle the failure of the channel, which is closed already."""


class Counts(NamedTuple):
    """Messages that a channel received in part or not at all.

    Attributes:
        newest: number of the newest message seen, from 1, or None on a stream, where none is overtaken.
        lost: messages that were lost with a stream, as their route does not send them again.
        incomplete: messages that wait for some of their fragments.
        expired: messages given up because fragments did not come in time.
    """

    newest: int | None = 0
    incomplete: int = 0
    expired: int = 0
    lost: int = 0


class DataChannel(ABC):
    """Carries the messages of one incarnation of a route."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether messages get through."""

    @abstractmethod
    def trouble(self) -> Verdict | None:
        """Return the verdict on a channel over which nothing gets through now, or None."""

    @abstractmethod
    def close(self, reason: str) -> None:
        """Free it. The route hears no more of it."""


class ReceivingChannel(DataChannel):
    """The receiving end of a channel."""

    @abstractmethod
    def counts(self) -> Counts:
        """Counts of missing messages."""
