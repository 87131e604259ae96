"""The end of a route of calls on this side, as its facts read it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Stage
    from rsb_bridge.model.verdict import Cause


class Trouble(NamedTuple):
    """A problem to show to operators.

    Attributes:
        text: for an operator, with the remedy.
    """

    cause: Cause
    text: str


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

    @property
    def nodes_there(self) -> tuple[str, ...]:
        """The nodes on the other side that call or answer."""

    def at_node(self) -> tuple[int, int]:
        """Return the newest call that was given to DDS, with all before it, and how many calls wait for their node."""

    def stages(self) -> tuple[Stage, Stage, Stage]:
        """Return this half's view of three stages: a server is seen, its type is known, callers can call it."""

    def close(self) -> None:
        """End the opening."""
