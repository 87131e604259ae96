"""The base class of a link's features, through which they take part in connections, messages and regular work."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.model.purposes import Purpose


class Extension:
    """A feature of one link. `rsb_bridge.link.link.Link` registers it; it overrides what it needs.

    Attributes:
        messages: its handlers of control messages, by type. A handler may return work to be done in slices.
        purpose: the purpose of the internal routes that it serves, or None.
    """

    messages: Mapping[type, Callable[[Any], Slices | None]] = {}
    purpose: Purpose | None = None

    def connected(self) -> None:
        """Begin a connection: the peer is authenticated."""

    def disconnected(self) -> None:
        """End a connection. The extension that was registered last comes first."""

    def tick(self) -> None:
        """Do the regular work, once a second, linked or not."""

    def refusal(self, name: str) -> str:
        """Return why the peer may not have an internal route by that name now, or an empty string."""
        return ""

    def meter_of(self, route_id: int) -> Meter | None:
        """Return what counts the bytes that arrive for a route, or None."""
        return None
