"""What carries one route's messages: a stream of its own, datagrams, or a share of a stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.wire.framing import Message


class Counts(NamedTuple):
    """What a receiving path knows of messages that did not arrive whole.

    Attributes:
        newest: number of the newest message seen, from 1.
        incomplete: messages some of whose fragments wait for the rest.
        expired: messages given up because fragments did not come in time.
    """

    newest: int = 0
    incomplete: int = 0
    expired: int = 0


class DataChannel(Protocol):
    """One route's way to the peer, for one opening."""

    @property
    def ready(self) -> bool:
        """Whether messages may be sent or may come."""
        ...

    @property
    def congested(self) -> bool:
        """Whether it is better not to send now."""
        ...

    @property
    def batch_bytes(self) -> int:
        """How much to send at once, where a single message is not more."""
        ...

    def send(self, batch: Sequence[Message]) -> None:
        """Send messages, oldest first."""
        ...

    def trouble(self) -> str:
        """What seems wrong with it, in words; empty: nothing."""
        ...

    def counts(self) -> Counts | None:
        """Where messages are numbered: what is missing."""
        ...

    def close(self, reason: str) -> None:
        """Free it. The route hears no more of it."""
        ...
