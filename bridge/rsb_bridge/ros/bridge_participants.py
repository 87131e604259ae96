"""Finds out which endpoints are bridges', by their DDS participants.

All nodes of a bridge belong to one participant. The names of mirrored ones tell nothing
(`rsb_bridge.ros.ros_interface.Mirroring`). But a bridge publishes its announcement by its own node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.names import is_bridge

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import Endpoint

PARTICIPANT = 12
"""Bytes of an endpoint's GUID that are its participant's (RTPS 2.5, 9.3.1.1)."""
_MOST_OTHERS = 4096
"""Participants of ordinary nodes that are remembered. A round figure: forgotten ones are asked about again."""


class BridgeParticipants:
    """The participants of this bridge and of others in its domain. May be asked from any thread.

    Args:
        announcers: asks the graph for the publishers of announcements, which takes some 50 µs.
        version: another number when the graph has changed.
    """

    def __init__(self, announcers: Callable[[], Sequence[Endpoint]], version: Callable[[], int]) -> None:
        self._announcers = announcers
        self._version = version
        self._asked = -1
        self._own, self._own_node = b"", ""
        self._bridges: dict[bytes, str] = {}  # never changed, only replaced
        self._others: frozenset[bytes] = frozenset()

    def know(self, gid: bytes, node: str) -> None:
        """Note the participant of an endpoint of this bridge, whose node is `node`."""
        self._own, self._own_node = gid[:PARTICIPANT], node

    def owned(self, endpoint: Endpoint) -> Endpoint:
        """Return an endpoint with the name of its bridge's own node, if it is one of a bridge."""
        participant = endpoint.gid[:PARTICIPANT]
        bridge = self._own_node if participant == self._own else self._bridge(participant)
        return endpoint if bridge in ("", endpoint.node) else endpoint._replace(node=bridge)

    def _bridge(self, participant: bytes) -> str:
        # One that is new is asked for at once: the number changes only with the ROS thread's next turn, and a bridge's
        # announcement is the first that others discover of what it publishes.
        is_known = participant in self._others or participant in self._bridges
        if (version := self._version()) != self._asked or not is_known:
            found = self._announcers()
            self._bridges = {each.gid[:PARTICIPANT]: each.node for each in found if is_bridge(each.node)}
            if participant not in self._bridges:
                others = self._others if len(self._others) < _MOST_OTHERS else frozenset[bytes]()
                self._others = others | {participant}
            # Last: neither another thread nor the next look after a failure may go by what was known before.
            self._asked = version
        return self._bridges.get(participant, "")
