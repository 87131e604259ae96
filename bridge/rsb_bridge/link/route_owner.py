"""The link that a route table belongs to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeAlias

from rsb_bridge.link.authorizing import Authority
from rsb_bridge.route.route import Owner

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Coroutine

    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.snapshot import Level
    from rsb_bridge.route.route import Route

    OnRemoved: TypeAlias = Callable[[Route], None]


class RouteOwner(Owner, Authority, Protocol):
    """What the table asks of its link."""

    @property
    def linked_at(self) -> float:
        """s, when the present connection was made."""
        ...

    async def prepare_port(self, route: Route) -> None:
        """Have the port that a route names ready for the client.

        Raises:
            ListenError: it cannot be bound.
        """
        ...

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine beside."""
        ...

    def guarded(self, work: Callable[[], None]) -> None:
        """Do regular work; if it fails, this link's connection ends, not the others'."""
        ...

    def protocol_error(self, reason: str) -> None:
        """The peer broke the protocol: end the connection."""
        ...

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "") -> None:
        """Add an event about this link."""
        ...
