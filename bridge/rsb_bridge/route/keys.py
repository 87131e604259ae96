"""What identifies a route in commands and snapshots of one side."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import Propose


def route_key(link: str, proposal: Propose) -> str:
    """What identifies a route on this side: the link, the direction and the topic's name on the sending side.

    Of what is not a topic, its kind, too: a service may have a topic's name.

    Where the server adds a prefix that the client did not propose, the two sides' keys of a route that the server sends
    on differ. Keys do not cross the link: each side's commands and snapshots use its own.
    """
    kind = "" if proposal.kind == "topic" else f"{proposal.kind} "
    return f"{link} {'→' if proposal.from_client else '←'} {kind}{proposal.topic}"
