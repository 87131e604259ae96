"""The end of a link at which this side is: a client's or a server's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.data_channels import DataChannels
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import WaySnapshot
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose
    from rsb_bridge.wire.sealing import ConnectionKeys


class LinkEnd(Protocol):
    """The part of a link that differs between a client and a server: how it connects, and what the session says."""

    @property
    def address(self) -> str:
        """The peer's address, for operators."""

    @property
    def fingerprints(self) -> tuple[str, str]:
        """Fingerprints of the current and the next key, or empty strings."""

    @property
    def profile(self) -> LinkProfile:
        """The session's profile of the link's network."""

    @property
    def use_name(self) -> bool:
        """Whether the server prefixes topics with the client's name, as far as this side knows."""

    @property
    def prefixed(self) -> bool:
        """Whether this side's own session has the server prefix topics with the client's name."""

    @property
    def rights(self) -> Rights:
        """The peer's rights on this side."""

    @property
    def shut_down(self) -> bool:
        """Whether the link is down on purpose and waits for this side's operator."""

    def shared_port(self) -> int:
        """Return the port or channel of the link itself."""

    def ways_shown(self) -> tuple[WaySnapshot, ...]:
        """Return the ways to the peer, if there are several."""

    def with_local_name(self, proposal: Propose) -> Propose:
        """Return the peer's proposal with this side's name for the topic."""

    def client_names(self, topic: Topic) -> Topic:
        """Return a topic, which this side's operator may name as this side does, with the client's names."""

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know that this side's graph has a topic, or a service. May be called from any thread."""

    async def prepare_port(self, route: Route) -> None:
        """Prepare the port that a route names for the client; a client has none.

        Raises:
            ListenError: it cannot be bound.
        """

    # --- its connection

    def new_channels(self, control: ControlChannel, keys: ConnectionKeys) -> DataChannels:
        """Return the channels of an association that begins."""

    def doubts(self) -> None:
        """Take note that the connection may be dead."""

    def why_lost(self, reason: str) -> str:
        """Return the reason of a lost connection, with what this side knows about it."""

    def lost(self) -> None:
        """Plan the next connection: the present one is over, and the link shows why."""

    def tick(self) -> None:
        """Do the regular work once a second, linked or not."""
