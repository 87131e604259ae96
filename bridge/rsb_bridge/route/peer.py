"""The other side of a link, as a route and its parts see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.model.capacity import Fullness
    from rsb_bridge.model.faults import PathFault
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.lifecycle import Revisions
    from rsb_bridge.route.message_transform import FindTransforms
    from rsb_bridge.route.peer_budget import PeerBudget
    from rsb_bridge.telemetry.meters import ClockOffset
    from rsb_bridge.wire.messages import ControlMessageBase


class PeerPings(Protocol):
    """The pings of a link (`rsb_bridge.link.keepalive`), whose delay is about that of the peer's reports."""

    ping_delay: float

    @property
    def ping_wait(self) -> float: ...

    @property
    def quiet(self) -> float: ...

    @property
    def in_doubt(self) -> bool: ...


class LinkRates(Protocol):
    """Whether a link is full in either direction (`rsb_bridge.link.fullness`)."""

    out: Fullness | None
    into: Fullness | None

    @property
    def undecided(self) -> bool: ...


class LinkPath(Protocol):
    """The path of a link (`rsb_bridge.link.path_watch`)."""

    fault: PathFault | None


class Peer(Protocol):
    """The members of a link that a route uses."""

    name: str
    is_client: bool
    budget: PeerBudget
    revisions: Revisions
    clock: ClockOffset
    stamps: ClockOffset
    """Offset of the clock by which the peer stamps messages."""

    @property
    def profile(self) -> LinkProfile: ...

    @property
    def bridges(self) -> tuple[str, ...]:
        """Names of the bridge nodes in the peer's domain, its own first, or empty if not known yet."""

    @property
    def connections(self) -> int:
        """Number of connections so far, which identifies the present one."""

    @property
    def linked(self) -> bool: ...

    @property
    def is_looked_at(self) -> bool:
        """Whether somebody looks at the figures of its routes all the time, here or there."""

    @property
    def instance(self) -> str:
        """Random id of the peer's present or last process, or an empty string before the first connection."""

    @property
    def keepalive(self) -> PeerPings: ...

    @property
    def fullness(self) -> LinkRates: ...

    @property
    def path(self) -> LinkPath: ...

    @property
    def down_reason(self) -> str:
        """Reason why it isn't linked, for an operator."""

    @property
    def suspended_since(self) -> float | None:
        """When (s) its connection was lost, if its association lives on without one, or None."""

    def send(self, message: ControlMessageBase) -> object:
        """Send a control message; without a connection, nothing happens."""

    def shared_port(self) -> int:
        """Return the port or channel of the link itself."""

    def route_fields(self, route: Any) -> dict[str, Any]:
        """Return what features show of one of its routes."""

    @property
    def verdicts(self) -> Callable[[Any], Iterable[Verdict]] | None:
        """Function that returns the verdicts of features on one of its routes, or None if none judges."""

    @property
    def transforms(self) -> Callable[[Any], FindTransforms | None] | None:
        """Function that looks for what changes one of its routes' messages, or None if no feature does so."""

    @property
    def explain(self) -> Callable[[Any, Verdict], Verdict] | None:
        """Function that adds what features know about a verdict's cause to its text, or None if none knows more."""

    def closed(self, route_id: int) -> None:
        """Note the end of a route's opening: control messages about it that still come are late."""
