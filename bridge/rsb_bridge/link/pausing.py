"""Pausing and resuming a link's routes on both sides, whoever asks for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.wire.messages import Pause

if TYPE_CHECKING:
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose


class Pausing:
    """Tells the peer of pauses, and takes its own.

    Args:
        peer: the other side.
        peer_operators: record what is paused and resumed there.
    """

    def __init__(self, peer: Peer, peer_operators: PeerOperators) -> None:
        self._peer = peer
        self._peer_operators = peer_operators

    def pause(self, route: Route, *, paused: bool) -> None:
        """Pause or resume a route on both sides."""
        who = acting_operator()
        route.pause(paused, who)
        self._send(route, who)

    def taken_up(self, route: Route, proposal: Propose, *, known: bool) -> None:
        """The peer proposes a route, paused or not; this side's operators may have changed that since.

        Args:
            route: this side's half.
            proposal: the peer's.
            known: whether this side's revisions are about the peer's present process.
        """
        self.from_peer(route, proposal, known=known)
        if (route.paused, route.pausing.revision) != (proposal.paused, proposal.pause_revision):
            self._send(route)  # an operator of this side changed it while the link was down

    def from_peer(self, route: Route, message: Pause | Propose, *, known: bool = True) -> None:
        """The peer tells its state of the pause; what an operator there has changed is recorded here, too."""
        was, who = route.paused, message.who if isinstance(message, Pause) else ""
        revision = message.revision if isinstance(message, Pause) else message.pause_revision
        route.pause_from_peer(message.paused, revision, self._peer_operators.says(who), known=known)
        if route.paused != was and known:
            self._peer_operators.paused(route, who)

    def _send(self, route: Route, who: str = "") -> None:
        if route.id:
            self._peer.send(Pause(route=route.id, paused=route.paused, revision=route.pausing.revision, who=who))
