"""The other side of a link, as far as a route and its parts know it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rsb_bridge.model.fullness import Fullness
    from rsb_bridge.model.profiles import LinkProfile
    from rsb_bridge.route.pause import Revisions
    from rsb_bridge.route.peer_budget import PeerBudget
    from rsb_bridge.wire.messages import ControlMessage


class Peer(Protocol):
    """What a route asks of its link."""

    name: str
    is_client: bool
    budget: PeerBudget
    revisions: Revisions

    @property
    def profile(self) -> LinkProfile:
        """What the link's network is like."""
        ...

    @property
    def bridges(self) -> tuple[str, ...]:
        """The names of the bridge nodes in the peer's domain, its own first; empty: not known yet."""
        ...

    @property
    def connections(self) -> int:
        """How many connections there have been: tells one from the next."""
        ...

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        ...

    @property
    def instance(self) -> str:
        """The peer's process, present or last: random, new with each start; empty: there has been none."""
        ...

    @property
    def features(self) -> tuple[str, ...]:
        """What the peer, present or last, can do beyond version 2 of the wire format."""
        ...

    @property
    def clock_offset(self) -> float | None:
        """s, the peer's clock minus ours."""
        ...

    @property
    def clock_uncertainty(self) -> float | None:
        """Seconds by which `clock_offset` may be wrong."""
        ...

    @property
    def stamp_offset(self) -> float | None:
        """s, the clock that the peer stamps messages by minus this side's clock of stamps."""
        ...

    @property
    def stamp_uncertainty(self) -> float | None:
        """Seconds by which `stamp_offset` may be wrong."""
        ...

    @property
    def stamp_shift(self) -> int:
        """Nanoseconds to add to a stamp of the wall clock before it is sent."""
        ...

    @property
    def report_delay(self) -> float:
        """About how many s the peer's reports take to get here."""
        ...

    @property
    def ping_wait(self) -> float:
        """Seconds that the oldest unanswered ping has waited; 0 if all are answered."""
        ...

    @property
    def full_out(self) -> Fullness | None:
        """The rates from here, or None if the link is not full."""
        ...

    @property
    def fullness_undecided(self) -> bool:
        """Whether the link from here may be full, which is being measured."""
        ...

    @property
    def full_in(self) -> Fullness | None:
        """The rates to here, or None if the link is not full."""
        ...

    @property
    def down_reason(self) -> str:
        """Why it isn't linked, for an operator."""
        ...

    def send(self, message: ControlMessage) -> None:
        """Send a control message; without a connection, nothing happens."""
        ...

    def shared_port(self) -> int:
        """The port or channel of the link itself."""
        ...

    def closed(self, route_id: int) -> None:
        """A route's opening is over: messages about it that still come are late."""
        ...
