"""The filter that keeps messages from circling through several bridges, and the sources of messages.

Every bridge announces in its domain which bridges the messages of each of its publishers have crossed
(`rsb_bridge.ros.announcements`). A sending half leaves out messages that already were in the receiver's domain under
the topic's name there. It groups messages by the bridges that they crossed: each group is a *source* with a number. The
receiving half has a publisher for each source and announces its hops in turn. So no message crosses a bridge twice, and
every message still gets everywhere that it can reach otherwise.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.hops import MOST_HOPS, MOST_SOURCES, Via, hop, node_of_hop, topic_place
from rsb_bridge.model.qos import QUEUE_BYTES, incompatible
from rsb_bridge.model.text import join_first
from rsb_bridge.wire.framing import SOURCE_SHIFT
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
    from rsb_bridge.route.route import Route

# The numbers are round figures: nothing was measured.
EXPLAINED_WITHIN = (
    3.0  # s in which a publisher's hops are announced, or it counts as an ordinary node's. Messages could
)
# go round with less while DDS is slow; with more, those from a node without a name wait longer.
_HEARD_WITHIN = 1.0  # s until it is heard that a publisher is no longer alive, which is said and read within 0.1
_GONE_REMEMBERED = 256  # publishers
_MOST_HELD = 10_000  # messages: 3 s at 3 kHz
_MOST_NAMED = 5  # nodes in one sentence
HELD = -1
"""No number yet: keep the message until there is one."""
LEFT_OUT = -2
"""No number ever: the message must not be carried."""


class Publication(NamedTuple):
    """A publisher on a route's topic."""

    gid: bytes
    node: str  # its node's name, without the ``/`` before it
    via: Via | None  # the bridges that its messages crossed: empty for an ordinary node, None if not known yet
    live: bool = True  # messages still reach it
    alive: bool = False  # its bridge asserts its liveliness


class SourceTable:
    """The sources of one opening of a route, as its sending half numbers them."""

    def __init__(self) -> None:
        self.sources: tuple[Source, ...] = ()  # that need a publisher on the peer, by number. Only grows
        self.echoes: tuple[Publication, ...] = ()  # left out: their messages were in the peer's domain before
        # Left out for `MOST_HOPS` or `MOST_SOURCES`, or for the peer's limits.
        self.too_far: tuple[Publication, ...] = ()
        self.unexplained: tuple[Publication, ...] = ()  # whose hops have not been announced yet
        self.flags: dict[bytes, int] = {}  # with the source's number, by publisher, if its messages may be sent now
        self.moved = False  # a known publisher's messages have come to belong to another source
        self.one_place = False  # both sides are in one domain and have the same topic: the route itself is a loop
        self._hop = ""
        self._numbers: dict[bytes, int] = {}
        self._first_seen: dict[bytes, float] = {}
        self._described = 0
        self._answers_due = 0
        self._accepted = 0

    def update(
        self, publications: Iterable[Publication], hop: str, here: frozenset[str], there: frozenset[str], now: float
    ) -> None:
        """Update the decision about all publishers on the topic.

        Args:
            publications: all publications except this link's own.
            hop: this bridge's hop from the topic.
            here: the topic in this domain, as a place.
            there: the topic in the peer's domain, under its name there.
        """
        sources = [*self.sources]
        known = {source.via: number for number, source in enumerate(sources)}
        live = {number for number, source in enumerate(sources) if source.live and len(source.via) == 1}
        numbers: dict[bytes, int] = {}
        first_seen: dict[bytes, float] = {}
        echoes, too_far, unexplained = [], [], []
        # The nearest first: if the numbers run out, the farthest publishers are left out.
        for each in sorted(publications, key=_nearest_first):
            via = each.via
            if via is None:
                first_seen[each.gid] = self._first_seen.get(each.gid, now)
                if now < first_seen[each.gid] + EXPLAINED_WITHIN:  # as `explained_by` says, to the last digit
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
            # The peer has answered, and has no publisher for it.
            if self._accepted <= number < self._described and not self._answers_due:
                too_far.append(each)
        self.one_place = hop in there
        self._hop = hop
        self.sources = tuple(Source(via=source.via, live=number in live) for number, source in enumerate(sources))
        self.echoes, self.too_far, self.unexplained = tuple(echoes), tuple(too_far), tuple(unexplained)
        self._first_seen = first_seen
        # Messages of publishers that are gone may still be in transit.
        gone = [gid for gid in self._numbers if gid not in numbers]
        for gid in gone[: max(0, len(gone) - _GONE_REMEMBERED)]:
            del self._numbers[gid]
        self.moved = self.moved or any(0 <= number != self._numbers.get(gid, number) for gid, number in numbers.items())
        self._numbers |= numbers
        self._sort_out()

    def to_describe(self) -> tuple[Source, ...]:
        """Return the sources; add one for the first publisher to come if there is no source and none is expected."""
        if not (self.sources or self.unexplained or self.too_far):
            self.sources = (Source(via=(self._hop,), live=False),)
        return self.sources

    def described(self) -> None:
        """Note that the present sources were sent to the peer; it answers each time."""
        self._described = len(self.sources)
        self._answers_due += 1

    def answered(self, accepted: int) -> None:
        """Note the peer's answer: it has publishers for the first `accepted` sources."""
        self._answers_due = max(0, self._answers_due - 1)
        self._accepted = accepted
        self._sort_out()

    def _sort_out(self) -> None:
        numbers = self._numbers.items()
        self.flags = {gid: number << SOURCE_SHIFT for gid, number in numbers if 0 <= number < self._accepted}

    def number_of(self, gid: bytes) -> int:
        """Return the number of the source of a publisher's messages, or `HELD` or `LEFT_OUT`."""
        number = self._numbers.get(gid, HELD)
        if number < self._accepted:
            return number
        return HELD if self._answers_due or number >= self._described else LEFT_OUT

    def knows(self, gid: bytes) -> bool:
        """Whether `update` has seen a publisher."""
        return gid in self._numbers or gid in self._first_seen

    @property
    def explained_by(self) -> float:
        """Time (s) when the first of `unexplained` will count as an ordinary node's."""
        return min(self._first_seen[each.gid] for each in self.unexplained) + EXPLAINED_WITHIN

    def left_out(self, gid: bytes) -> bool:
        return self._numbers.get(gid) == LEFT_OUT

    @property
    def closes_loop(self) -> bool:
        """Whether all messages that the route could carry were in the peer's domain before."""
        return self.one_place or (
            any(each.live for each in self.echoes)
            and not (self.unexplained or self.too_far or any(source.live for source in self.sources))
        )

    @property
    def full(self) -> bool:
        """Whether some source has no number while dead sources hold some: a new opening would have room."""
        return bool(self.too_far) and not all(source.live for source in self.sources)

    def culprits(self) -> list[str]:
        """Return the nodes of the bridges that the echoes crossed, nearest to the peer first."""
        return list(dict.fromkeys(node_of_hop(hop) for each in self.echoes for hop in each.via or ()))


def _nearest_first(publication: Publication) -> tuple[bool, int, Via]:
    via = publication.via
    return via is None, len(via or ()), via or ()


class LoopFilter:
    """The loop filter of one sending half.

    Attributes:
        table: the sources of the present opening.
    """

    def __init__(self, route: Route) -> None:
        """Begin with an empty table.

        Args:
            route: advances when the wait for a publisher's hops is over: `update` decides about it then.
        """
        self.table = SourceTable()
        self._overflowed = 0
        self._route = route
        self._context = route.context
        self._timer: asyncio.TimerHandle | None = None
        self._held: deque[RawMessage] = deque()
        self._held_bytes = 0
        self._qos: dict[bytes, Qos] = {}  # of the publishers, by id
        self._asserted: dict[bytes, float] = {}  # s, when publishers that are left out were alive last, by id

    def update(self, topic: str, remote_topic: str) -> list[Endpoint]:
        """Update the table from the ROS graph; return the publishers whose messages may be carried."""
        announcements, ros, peer = self._context.announcements, self._context.ros, self._route.peer
        endpoints = publishers_besides(self._route, topic)
        publications = [
            Publication(each.gid, each.node.lstrip("/"), *(announcements.origin_of(each) or (None,)))
            for each in endpoints
        ]
        known = {each.gid for each in endpoints}
        # A message may come before the graph shows its publisher. A publisher without an id will never be shown.
        publications += [Publication(gid, "", None if gid else ()) for gid in {held.gid for held in self._held} - known]
        self.table.update(
            publications,
            hop(ros.node_name, topic),
            topic_place(announcements.bridges, topic),
            topic_place(peer.bridges, remote_topic),
            self._context.now(),
        )
        self._qos = {each.gid: each.qos for each in endpoints}
        self._cancel_timer()
        if self.table.unexplained:  # earlier announcements trigger `update` anyway
            delay = self.table.explained_by - self._context.now()
            self._timer = self._context.loop.call_later(delay, self._route.advance)
        return [each for each in endpoints if not self.table.left_out(each.gid)]

    def alive_left_out(self, requested: Qos) -> int:
        """Return how many publishers may be alive whose messages are left out, for a subscription of that QoS.

        Else two bridges would keep each other's publishers alive.
        """
        now, table = self._context.now(), self.table
        left_out = {each.gid for each in table.unexplained}
        for each in table.echoes:
            if each.alive:
                self._asserted[each.gid] = now
            elif (
                now - self._asserted.get(each.gid, float("-inf")) > requested.liveliness_lease_duration + _HEARD_WITHIN
            ):
                continue
            left_out.add(each.gid)
        self._asserted = {gid: at for gid, at in self._asserted.items() if gid in left_out}
        return sum(gid in self._qos and not incompatible(self._qos[gid], requested) for gid in left_out)

    def admit(self, batch: Sequence[RawMessage]) -> tuple[list[RawMessage], bool]:
        """Sort messages; hold those with an unknown source until `release`.

        Returns:
            The messages to send now, and whether `update` has not yet seen a publisher of the held ones.
        """
        admitted: list[RawMessage] = []
        unseen = False
        for message in batch:
            number = self.table.number_of(message.gid)
            if number >= 0:
                admitted.append(message)
            elif number != LEFT_OUT:
                self._held.append(message)
                self._held_bytes += len(message.payload)
                unseen = unseen or not self.table.knows(message.gid)
        while len(self._held) > 1 and (len(self._held) > _MOST_HELD or self._held_bytes > QUEUE_BYTES):
            self._held_bytes -= len(self._held.popleft().payload)
            self._overflowed += 1
        return admitted, unseen

    def release(self) -> list[RawMessage]:
        """Return the held messages that may be sent now; to be called after each change of the table."""
        if not self._held:
            return []
        # `admit` holds messages of unknown sources again, so they are taken out first.
        held = tuple(self._held)
        self.forget()
        return self.admit(held)[0]

    def forget(self) -> int:
        held = len(self._held)
        self._held.clear()
        self._held_bytes = 0
        return held

    def loop(self, topic: str) -> str:
        """Return the reason why the route would close a loop, or an empty string."""
        domain = self._context.domain_id
        if self.table.one_place:
            return (
                f"both sides publish {topic} in one ROS domain, {domain}: messages would loop; give the two sides "
                "different domains (domain_id), or set use_name on the server"
            )
        if self.table.closes_loop:
            return (
                f"messages would loop: all of {topic} in domain {domain} already comes from this route's destination "
                f"through {join_first(self.table.culprits(), _MOST_NAMED)}; remove this route or one of theirs"
            )
        return ""

    def outdated(self, qos: Qos | None) -> bool:
        """Whether a new opening has to renumber the sources.

        Either dead sources hold numbers that live ones need; or a latched topic's publisher has moved to another
        source, while the peer keeps its messages with the previous one.
        """
        return self.table.full or (self.table.moved and qos is not None and qos.latched)

    def left_out(self) -> str:
        """Return the nodes whose messages are left out, as the end of a sentence, or an empty string."""
        words = ""
        if not self.table.echoes and not self.table.too_far:  # as nearly always
            return words
        if echoes := _nodes(self.table.echoes):
            words += f"; left out: messages from {echoes}, which come from the other side"
        if too_far := _nodes(self.table.too_far):
            words += f"; left out: messages from {too_far}, which cross too many bridges or come by too many paths"
        return words

    def unexplained(self) -> str:
        """Return the nodes whose announcement is awaited, in words."""
        nodes = _nodes(self.table.unexplained) or "a node that is not known yet"
        return f"waiting for {nodes} to announce which bridges its messages crossed"

    @property
    def holds(self) -> int:
        return len(self._held)

    def give_up(self) -> int:
        """Return the number of messages lost since the last call because too many had to be held."""
        given_up, self._overflowed = self._overflowed, 0
        return given_up

    def clear(self) -> None:
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


def publishers_besides(route: Route, topic: str) -> list[Endpoint]:
    """Return the publishers of a topic here besides those of a route's link."""
    own = route.context.announcements.own_publishers(topic, besides=route.peer.name)
    return [*route.ends.publishers(topic), *own]
