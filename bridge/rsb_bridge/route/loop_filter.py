"""Which messages a route may carry without closing a loop of bridges, and from which source they are.

Every bridge tells, in its domain, by which bridges the messages of each of its publishers came there
(`rsb_bridge.ros.announcements`). A sending half leaves out the messages that were in the receiver's domain before,
under the topic's name there. It keeps messages that came by different bridges apart, each as a *source* with a number,
and the receiving half has a publisher for each source and announces its hops in turn. So a message crosses no bridge
twice, and whatever can get somewhere without that does get there.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.sources import MOST_HOPS, MOST_SOURCES, Via, hop, node_of, place
from rsb_bridge.model.text import join_first
from rsb_bridge.wire.framing import SOURCE_SHIFT
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
    from rsb_bridge.route.peer import Peer

EXPLAINED_WITHIN = 3.0
"""s that a bridge has to say by which bridges a publisher's messages came; then it is taken for no bridge's."""
HELD = -1
"""No number yet: keep the message until there is one."""
LEFT_OUT = -2
"""No number ever: the message must not be carried."""
_GONE_REMEMBERED = 256
_MOST_HELD = 10_000  # messages
_MOST_HELD_BYTES = 32 << 20  # as many as wait to be sent: an image that comes first is not lost
_MOST_NAMED = 5  # nodes in one sentence


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


class LoopFilter:
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
