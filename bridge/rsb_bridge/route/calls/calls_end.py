"""The end of a route of calls on this side, as its facts read it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from rsb_bridge.model.verdict import Cause


class Trouble(NamedTuple):
    """A problem to show to operators.

    Attributes:
        text: for an operator, with the remedy.
    """

    cause: Cause
    text: str


class CallsProgress(NamedTuple):
    """The progress of calls, as one half knows it.

    Attributes:
        served: whether nodes answer, or None if it is unknown.
        providers: names of these nodes.
        why_unserved: the reason why none answers, or empty.
        type_name: as last known, or empty.
        offered: whether callers can call it, as far as this half knows.
        offer_failed: whether this half is kept from its part in offering it.
        why_not_offered: the reason why it is not offered, or empty.
    """

    served: bool | None = None
    providers: tuple[str, ...] = ()
    why_unserved: str = ""
    type_known: bool = False
    type_name: str = ""
    offered: bool = False
    offer_failed: bool = False
    why_not_offered: str = ""


class MalformedCall(NamedTuple):
    """A request, a response or a message that does not fit its type.

    Attributes:
        field: and what is wrong with it.
    """

    type_name: str
    field: str


class CallsEnd(Protocol):
    """The end of a route of calls on this side: the offer to callers here, or the servers here.

    Attributes:
        warning: the trouble that does not keep calls from crossing, or None.
    """

    warning: Trouble | None

    def proceed(self) -> None:
        """Offer what can be called, or withdraw it; here, or to the other side."""

    @property
    def offered(self) -> bool:
        """Whether callers can call it, as far as this half knows."""

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called, or None if this side knows of none."""

    def nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the nodes that call, and the nodes that answer."""

    def at_node(self) -> tuple[int, int]:
        """Return the newest call that was given to DDS, with all before it, and how many calls wait for their node."""

    def progress(self) -> CallsProgress:
        """Return how far calls get, as this half knows it."""

    def close(self) -> None:
        """End the opening."""
