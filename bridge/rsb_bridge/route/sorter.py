"""Sorts a route's messages by source, and holds messages whose source is not known yet."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.sources import hop, place
from rsb_bridge.model.text import join_first
from rsb_bridge.route.sources import LEFT_OUT, Publication, SourceTable

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
    from rsb_bridge.route.peer import Peer

_MOST_HELD = 10_000  # messages
_MOST_HELD_BYTES = 32 << 20  # as many as wait to be sent: an image that comes first is not lost
_MOST_NAMED = 5  # nodes in one sentence


class Sorter:
    """One sending half's.

    Attributes:
        table: the sources of the present opening.
    """

    def __init__(self, context: Context, peer: Peer, due: Callable[[], None]) -> None:
        """Nothing is kept back yet.

        Args:
            context: what every part of the engine shares.
            peer: whom the messages go to.
            due: called when publishers have been waited for long enough: `look` decides about them then.
        """
        self.table = SourceTable()
        self._overflowed = 0
        self._context = context
        self._due = due
        self._timer: asyncio.TimerHandle | None = None
        self._peer = peer
        self._held: deque[RawMessage] = deque()
        self._held_bytes = 0

    def look(self, topic: str, remote_topic: str) -> list[Endpoint]:
        """See who publishes on the topic; the publishers whose messages may be carried."""
        announcements, ros = self._context.announcements, self._context.ros
        endpoints = [*ros.publishers(topic), *announcements.own_publishers(topic, besides=self._peer.name)]
        publications = [
            Publication(each.gid, each.node.lstrip("/"), *(announcements.origin_of(each) or (None,)))
            for each in endpoints
        ]
        known = {each.gid for each in endpoints}
        publications += [Publication(gid, "", None if gid else ()) for gid in {held.gid for held in self._held} - known]
        self.table.update(
            publications,
            hop(ros.node_name, topic),
            place(announcements.bridges, topic),
            place(self._peer.bridges, remote_topic),
            self._context.now(),
        )
        self._wait()
        return [each for each in endpoints if not self.table.left_out(each.gid)]

    def _wait(self) -> None:
        """Call `due` when the next publisher has been waited for long enough; before that, news make routes look."""
        self._cancel_timer()
        if self.table.unexplained:
            delay = self.table.explained_by - self._context.now()
            self._timer = self._context.loop.call_later(delay, self._due)

    def carries(self, batch: Sequence[RawMessage]) -> bool:
        """Whether all of these messages may be sent now, and need not be sorted."""
        flags = self.table.flags
        for message in batch:  # noqa: SIM110 — every message passes here: a generator takes three times as long
            if message.gid not in flags:
                return False
        return True

    def admit(self, batch: Sequence[RawMessage]) -> tuple[list[RawMessage], bool]:
        """Sort messages; those whose source is not known yet are held until `release`.

        Returns:
            Those that may be sent now, and whether there is a publisher among the others that `look` has not seen.
        """
        admitted: list[RawMessage] = []
        unseen = False
        for message in batch:
            number = self.table.number_of(message.gid)
            if number >= 0:
                admitted.append(message)
            elif number != LEFT_OUT:
                self._hold(message)
                unseen = unseen or not self.table.knows(message.gid)
        return admitted, unseen

    def release(self) -> list[RawMessage]:
        """Those of the held messages that may be sent now; to be called whenever the table has changed."""
        if not self._held:
            return []
        held = tuple(self._held)
        self.forget()
        return self.admit(held)[0]

    def forget(self) -> int:
        """Drop the held messages; returns how many they were."""
        held = len(self._held)
        self._held.clear()
        self._held_bytes = 0
        return held

    def _hold(self, message: RawMessage) -> None:
        self._held.append(message)
        self._held_bytes += len(message.payload)
        while len(self._held) > 1 and (len(self._held) > _MOST_HELD or self._held_bytes > _MOST_HELD_BYTES):
            self._held_bytes -= len(self._held.popleft().payload)
            self._overflowed += 1

    def loop(self, topic: str) -> str:
        """Why the route would close a loop; empty: it would not."""
        domain = self._context.domain_id
        if self.table.one_place:
            return (
                f"both sides publish {topic} in one ROS domain, {domain}: messages would loop; give the two sides "
                "different domains (domain_id), or set use_name on the server"
            )
        if self.table.closes_loop:
            return (
                f"messages would loop: all of {topic} in domain {domain} comes from where this route leads, through "
                f"{join_first(self.table.culprits(), _MOST_NAMED)}; remove this route or one of theirs"
            )
        return ""

    def outdated(self, qos: Qos | None) -> bool:
        """Whether a new opening has to number the sources anew.

        Some are there for nothing while others find no number; or a latched topic's publisher has come to belong to
        another source, and the peer keeps its messages with the one before.
        """
        return self.table.full or (self.table.moved and qos is not None and qos.latched)

    def left_out(self) -> str:
        """Whose messages are left out of what is sent, as the end of a sentence; empty: nobody's."""
        words = ""
        if echoes := _nodes(self.table.echoes):
            words += f"; left out: messages from {echoes}, which come from the other side"
        if too_far := _nodes(self.table.too_far):
            words += f"; left out: messages from {too_far}, which come by too many ways or over too many bridges"
        return words

    def unexplained(self) -> str:
        """Who is waited for."""
        nodes = _nodes(self.table.unexplained) or "a node that is not known yet"
        return f"waiting for {nodes} to announce which bridges its messages crossed"

    @property
    def holds(self) -> int:
        """How many messages are kept back."""
        return len(self._held)

    def give_up(self) -> int:
        """How many messages are lost, since this was last asked, because too many had to be kept back."""
        given_up, self._overflowed = self._overflowed, 0
        return given_up

    def clear(self) -> None:
        """A new opening begins: nothing is kept, nothing numbered."""
        self._cancel_timer()
        self.table = SourceTable()
        self._overflowed = 0
        self.forget()

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _nodes(publications: Iterable[Publication]) -> str:
    return join_first(sorted({each.node for each in publications if each.node}), _MOST_NAMED)
