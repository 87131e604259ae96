"""Which messages a route may carry without closing a loop of bridges: pure decisions, no ROS and no clock.

Every bridge tells, in its domain, by which bridges the messages of each of its publishers came there
(`rsb_bridge.ros.announcements`). A sending half leaves out the messages that were in the receiver's domain before,
under the topic's name there. It keeps messages that came by different bridges apart, each as a *source* with a number,
and the receiving half has a publisher for each source and announces its hops in turn. So a message crosses no bridge
twice, and whatever can get somewhere without that does get there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.sources import MOST_HOPS, MOST_SOURCES, Via, node_of
from rsb_bridge.wire.framing import SOURCE_SHIFT
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    from collections.abc import Iterable

EXPLAINED_WITHIN = 3.0
"""s that a bridge has to say by which bridges a publisher's messages came; then it is taken for no bridge's."""
HELD = -1
"""No number yet: keep the message until there is one."""
LEFT_OUT = -2
"""No number ever: the message must not be carried."""
_GONE_REMEMBERED = 256


class Publication(NamedTuple):
    """A publisher on a route's topic.

    Attributes:
        gid: its id.
        node: its node's name, without the ``/`` before it.
        via: the bridges that its messages crossed; empty: it is no bridge's; None: not known yet.
        live: False: nothing reaches it any more.
    """

    gid: bytes
    node: str
    via: Via | None
    live: bool = True


class SourceTable:
    """The sources of one opening of a route, as its sending half numbers them.

    Attributes:
        sources: what the peer is to have publishers for, by number. Only grows.
        echoes: the publications that are left out because their messages were in the peer's domain before.
        too_far: the publications that are left out for `MOST_HOPS` or `MOST_SOURCES`, or for the peer's limits.
        unexplained: the publications that are waited for.
        flags: of the messages that may be sent now, by publisher: the number of the source as it is sent.
    """

    def __init__(self) -> None:
        self.sources: tuple[Source, ...] = ()
        self.echoes: tuple[Publication, ...] = ()
        self.too_far: tuple[Publication, ...] = ()
        self.unexplained: tuple[Publication, ...] = ()
        self.flags: dict[bytes, int] = {}
        self.moved = False  # a known publisher's messages have come to belong to another source
        self._hop = ""
        self._one_place = False
        self._numbers: dict[bytes, int] = {}
        self._first_seen: dict[bytes, float] = {}
        self._told = 0
        self._answers_due = 0
        self._accepted = 0

    def update(
        self, publications: Iterable[Publication], hop: str, here: frozenset[str], there: frozenset[str], now: float
    ) -> None:
        """Decide anew about all publishers on the topic.

        Args:
            publications: all of them, but for those of this link itself.
            hop: of this bridge, from the topic.
            here: the topic in this domain, as a place.
            there: the topic in the peer's domain, under its name there.
            now: s.
        """
        sources = [*self.sources]
        known = {source.via: number for number, source in enumerate(sources)}
        live = {number for number, source in enumerate(sources) if source.live and len(source.via) == 1}
        numbers: dict[bytes, int] = {}
        first_seen: dict[bytes, float] = {}
        echoes, too_far, unexplained = [], [], []
        for each in sorted(publications, key=_nearest_first):
            via = each.via
            if via is None:
                first_seen[each.gid] = self._first_seen.get(each.gid, now)
                if now - first_seen[each.gid] < EXPLAINED_WITHIN:
                    unexplained.append(each)
                    continue
                via = ()
            whole = (*via, hop)
            if not (here.isdisjoint(via) and there.isdisjoint(whole)):
                numbers[each.gid] = LEFT_OUT
                echoes.append(each)
                continue
            number = known.get(whole)
            if number is None:
                if len(whole) > MOST_HOPS or len(sources) >= MOST_SOURCES:
                    numbers[each.gid] = LEFT_OUT
                    too_far.append(each)
                    continue
                number = known[whole] = len(sources)
                sources.append(Source(via=whole))
            numbers[each.gid] = number
            if each.live:
                live.add(number)
            if self._accepted <= number < self._told and not self._answers_due:
                too_far.append(each)
        self._one_place = hop in there
        self._hop = hop
        self.sources = tuple(Source(via=source.via, live=number in live) for number, source in enumerate(sources))
        self.echoes, self.too_far, self.unexplained = tuple(echoes), tuple(too_far), tuple(unexplained)
        self._first_seen = first_seen
        # What publishers that are gone have published may still be on its way.
        gone = [gid for gid in self._numbers if gid not in numbers]
        for gid in gone[: max(0, len(gone) - _GONE_REMEMBERED)]:
            del self._numbers[gid]
        self.moved = self.moved or any(0 <= number != self._numbers.get(gid, number) for gid, number in numbers.items())
        self._numbers |= numbers
        self._sort_out()

    def to_describe(self) -> tuple[Source, ...]:
        """The sources; where there are none, and none is waited for, one for whoever will publish first."""
        if not (self.sources or self.unexplained or self.too_far):
            self.sources = (Source(via=(self._hop,), live=False),)
        return self.sources

    def told(self) -> None:
        """The peer is told of the sources as they are now; it answers each time."""
        self._told = len(self.sources)
        self._answers_due += 1

    def answered(self, accepted: int) -> None:
        """The peer has publishers for the first so many sources."""
        self._answers_due = max(0, self._answers_due - 1)
        self._accepted = accepted
        self._sort_out()

    def _sort_out(self) -> None:
        accepted = ((gid, number) for gid, number in self._numbers.items() if 0 <= number < self._accepted)
        self.flags = {gid: number << SOURCE_SHIFT for gid, number in accepted}

    def number_of(self, gid: bytes) -> int:
        """The number of the source that a publisher's messages belong to, or `HELD` or `LEFT_OUT`."""
        number = self._numbers.get(gid, HELD)
        if number < self._accepted:
            return number
        return HELD if self._answers_due or number >= self._told else LEFT_OUT

    def knows(self, gid: bytes) -> bool:
        """Whether `update` has seen a publisher."""
        return gid in self._numbers or gid in self._first_seen

    @property
    def explained_by(self) -> float:
        """s, when the first of `unexplained` will be taken for no bridge's."""
        return min(self._first_seen[each.gid] for each in self.unexplained) + EXPLAINED_WITHIN

    def left_out(self, gid: bytes) -> bool:
        """Whether a publisher's messages must not be carried."""
        return self._numbers.get(gid) == LEFT_OUT

    @property
    def one_place(self) -> bool:
        """Whether both sides are in one domain and have the same topic: the route itself is a loop."""
        return self._one_place

    @property
    def closes_loop(self) -> bool:
        """Whether all that the route could carry was in the peer's domain before."""
        others = any(source.live for source in self.sources) or self.unexplained or self.too_far
        return self._one_place or (any(each.live for each in self.echoes) and not others)

    @property
    def full(self) -> bool:
        """Whether a source finds no number while others are there for nothing: a new opening would have room."""
        return bool(self.too_far) and not all(source.live for source in self.sources)

    def culprits(self) -> list[str]:
        """The nodes of the bridges by which echoes came, nearest to the peer first."""
        return list(dict.fromkeys(node_of(hop) for each in self.echoes for hop in each.via or ()))


def _nearest_first(publication: Publication) -> tuple[bool, int, Via]:
    via = publication.via
    return via is None, len(via or ()), via or ()
