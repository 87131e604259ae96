"""An entry of a session that makes a route, with the proposal that says the same on the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rsb_bridge.model.session import Topic
    from rsb_bridge.wire.messages import Propose


class Entry(NamedTuple):
    """One side's entry of a route.

    Attributes:
        topic: it with the client's names, as this side's session lists it or would list it.
        proposal: it with the sender's and the receiver's names.
    """

    topic: Topic
    proposal: Propose
