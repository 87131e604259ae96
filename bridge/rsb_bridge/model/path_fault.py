"""Faults of the path between the two sides of a link: one cause for all topics that suffer from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import LinkSnapshot


class PathFaultText(Wording):
    """Texts about a path, with the remedy."""

    LOSSY = "{share} of packets are lost {way} {peer}: check its Wi-Fi or cable"
    LARGE_PACKETS = (
        "large packets are lost {way} {peer}, small ones arrive: "
        "lower the MTU on both sides (ip link set DEVICE mtu 1280)"
    )
    SILENT = "nothing comes from {peer} now: check that it is on, its cable or Wi-Fi, and firewalls"
    GONE = "the path to {peer} is in order again"


_LOST = frozenset(
    {
        Cause.NO_PATH, Cause.LOSSY, Cause.LATE, Cause.LINK_SLOW, Cause.CLOCK_UNKNOWN, Cause.QUEUE_FULL,
        Cause.SILENT, Cause.UNANSWERED,
    }
)  # fmt: skip
_OF_TOPICS = {
    LinkCause.LOSSY: (Cause.LOSSY, _LOST),
    LinkCause.LARGE_PACKETS: (Cause.NO_PATH, frozenset({Cause.NO_PATH, Cause.LOSSY})),
    LinkCause.SILENT: (Cause.AWAITS_LINK, _LOST | {Cause.AWAITS_LINK}),
}
"""By the cause of a link that is up: the cause of topics that suffer from it, and the causes that it replaces."""


class PathFault(NamedTuple):
    """A fault of a link's path while the link is up.

    Attributes:
        cause: `LinkCause.LOSSY`, `LARGE_PACKETS` or `SILENT`.
        text: for an operator, with the remedy.
    """

    cause: LinkCause
    text: str

    def of_topic(self, cause: str) -> Cause | None:
        """Return the cause to show instead of a topic's own, or None if the path does not explain that."""
        shown, explained = _OF_TOPICS[self.cause]
        return shown if cause in explained else None


def explained_by_link(cause: str, link: LinkSnapshot | None) -> bool:
    """Whether a route's fault of that cause is its link's, so that one report is enough."""
    if cause == Cause.LINK_DOWN:
        return True
    if link is None or link.cause not in _OF_TOPICS:
        return False
    return cause == _OF_TOPICS[LinkCause(link.cause)][0]
