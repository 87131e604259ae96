"""The nodes that this bridge mirrors for all its links, and the names that are taken in its domain."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import TEXT_LENGTH, RosError, Wording
from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.patterns import is_hidden

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from rsb_bridge.feature_api import Context


class NotMirrored(Wording):
    """The reasons why a node is not mirrored."""

    EXISTS = (
        "{node} is not mirrored: domain {domain} has a node of that name; give the link's names a prefix (use_name), "
        "or rename one of the two"
    )
    OTHER_BRIDGE = "{node} is not mirrored: {bridge} mirrors a node of that name here; set graph on one of them only"
    OTHER_LINK = "{node} is not mirrored: one of {link} has that name here; give the links' names a prefix (use_name)"
    TOO_MANY = "{limit} nodes are mirrored, the most of a link: stop those there that are not needed"
    NOT_SHOWN = "no node is mirrored: {reason}"
    LACKS = "no node is mirrored: the other side has no feature nodes; install all of rsb-console there"


def is_mirrorable(node: str) -> bool:
    """Whether a full name is one that ROS takes, and its tools show: neither a bridge's nor a tool's."""
    return len(node) <= TEXT_LENGTH and is_topic_name(node) and not is_hidden(node)


class MirrorTable:
    """The mirrored nodes of an engine. It belongs to the I/O loop, as all that makes endpoints.

    Attributes:
        links: by full name, each mirrored node's link.
    """

    def __init__(self, context: Context) -> None:
        self.links: dict[str, str] = {}
        self._context = context
        self._present: Collection[str] | None = None
        self._others: Mapping[str, str] = {}  # bridges by the nodes that they mirror

    def read(self) -> None:
        """Read the names of the domain's nodes. It takes some 50 µs, and 2 µs for each."""
        ros = self._context.ros
        try:
            self._present, self._others = frozenset(ros.node_names()), ros.mirrors.by_others()
        except RosError:  # the node has stopped
            self._present = self._present or frozenset()

    def clash(self, node: str, link: str) -> str:
        """Return the reason why a link may not mirror a node here, or not any longer, or an empty string."""
        if self._present is None:
            self.read()
        assert self._present is not None
        if node in self._present:
            return NotMirrored.EXISTS(node=node, domain=self._context.domain_id)
        own, bridge, mirrored_for = f"/{self._context.ros.node_name}", self._others.get(node), self.links.get(node)
        # Of two that have begun at once, the one with the lesser name goes on.
        if bridge is not None and (mirrored_for is None or bridge < own):
            return NotMirrored.OTHER_BRIDGE(node=node, bridge=bridge)
        return "" if mirrored_for in (None, link) else NotMirrored.OTHER_LINK(node=node, link=mirrored_for)

    def add(self, node: str, link: str) -> None:
        """Mirror a node; raise `RosError` where that is impossible."""
        self._context.ros.mirrors.add(node)
        self.links[node] = link

    def remove(self, node: str) -> None:
        del self.links[node]
        with contextlib.suppress(RosError):  # the node has stopped
            self._context.ros.mirrors.remove(node)
