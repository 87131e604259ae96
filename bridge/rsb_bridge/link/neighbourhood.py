"""The bridges in the ROS domains of both sides: each side tells the other who is in its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.wire.messages import Neighbours

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context


class Neighbourhood:
    """One link's.

    Attributes:
        bridges: the names of the bridge nodes in the peer's domain, its own first; empty: not known yet.
    """

    def __init__(self, context: Context, send: Callable[[Neighbours], None]) -> None:
        self.bridges: tuple[str, ...] = ()
        self._context = context
        self._send = send
        self._told: tuple[str, ...] = ()

    def tell(self) -> None:
        """Tell the linked peer which bridges are in this domain, if it does not know."""
        bridges = self._context.announcements.bridges
        if bridges != self._told:
            self._told = bridges
            self._send(Neighbours(bridges=bridges))

    def heard(self, neighbours: Neighbours) -> None:
        """The peer says which bridges are in its domain."""
        if neighbours.bridges != self.bridges:
            self.bridges = neighbours.bridges
            self._context.announcements.changed()

    def disconnected(self) -> None:
        """The next connection begins with nothing told or known."""
        self.bridges = self._told = ()
