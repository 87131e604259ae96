"""Beats: topics whose rate limits choose the same stamps, so that messages of one stamp cross or fall together.

A camera's image and its camera_info are of use together. They have one stamp, that of their header, and reach the
bridge one after the other, or begin seconds apart. So the first of a stamp is judged by its topic's own limit, and the
others follow.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakValueDictionary

from rsb_bridge.cdr.description import NESTED, read_description

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.rate_limit import Throttle
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_flow import TopicFlow

_STAMP = slice(4, 12)
"""Where the stamp of a message is that begins with a header, behind the 4 bytes of its encapsulation."""
_NO_STAMP = bytes(8)
_BEGIN_WITH_STAMP = frozenset({"std_msgs/msg/Header", "builtin_interfaces/msg/Time"})
_REMEMBERED = 2048
"""Stamps that a beat remembers at the least, as many as 70 topics at 30 Hz have in a second. A round figure."""
_TOGETHER = int(5e9)
"""ns within which messages of one stamp follow each other. Later, it is a recording that is played again."""


class _Decision(NamedTuple):
    """The decision on a stamp.

    Attributes:
        topic: the number of the one whose limit has judged it.
        at: ns, when its message came.
        due: ns, when the next one is due, or 0 if it was left out.
    """

    topic: int
    at: int
    due: int


class Beat:
    """The stamps that cross of the topics of one name and one rate, over one link."""

    def __init__(self) -> None:
        self.numbers = count()
        self._newer: dict[bytes, _Decision] = {}
        self._older: dict[bytes, _Decision] = {}

    def decision(self, stamp: bytes) -> _Decision | None:
        return self._newer.get(stamp) or self._older.get(stamp)

    def decide(self, stamp: bytes, decision: _Decision) -> None:
        if len(self._newer) >= _REMEMBERED:
            self._newer, self._older = {}, self._newer
        self._newer[stamp] = decision


class TopicInBeat:
    """One topic of a beat.

    Args:
        throttle: of the topic: keeps to its rate, also where its messages follow others.
    """

    def __init__(self, beat: Beat, throttle: Throttle) -> None:
        self._beat = beat
        self._throttle = throttle
        self._number = next(beat.numbers)

    def passes(self, message: RawMessage) -> bool:
        """Whether a message passes."""
        stamp, at = message.payload[_STAMP], message.stamp
        if stamp == _NO_STAMP:
            return self._throttle.passes(at)
        decision = self._beat.decision(stamp)
        # Its own decision is no reason: a publisher may never change its stamp.
        if decision is not None and decision.topic != self._number and abs(at - decision.at) < _TOGETHER:
            if decision.due:
                self._throttle.follow(decision.due)
            return decision.due > 0
        passes = self._throttle.passes(at)
        self._beat.decide(stamp, _Decision(self._number, at, self._throttle.due(b"") if passes else 0))
        return passes


class Beats:
    """All beats of an engine, and the types whose messages begin with a stamp."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._beats: WeakValueDictionary[tuple[str, str, float], Beat] = WeakValueDictionary()
        self._stamped: dict[str, bool] = {}  # by the type's hash
        self._awaiting: dict[str, set[Callable[[], None]]] = {}  # a type's description, by its hash
        self._tasks: set[asyncio.Task[None]] = set()

    def join(
        self, route: Route, flow: TopicFlow, throttle: Throttle, compose: Callable[[], None]
    ) -> TopicInBeat | None:
        """Have a topic follow its beat, or return None if it has none, no limit or no stamps.

        Args:
            compose: called if its type turns out to have no stamp. Until then, its messages count as stamped.
        """
        name, type_hash = route.proposal.beat, flow.type_hash
        if not (name and throttle.is_on and type_hash) or self._stamped.get(type_hash) is False:
            return None
        if (awaiting := self._awaiting.get(type_hash)) is not None:
            awaiting.add(compose)
        elif type_hash not in self._stamped:
            self._awaiting[type_hash] = {compose}
            task = self._context.loop.create_task(self._find(flow.type_name, type_hash, route.topic))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        key = route.peer.name, name, throttle.rate
        beat = self._beats.get(key) or Beat()
        self._beats[key] = beat
        return TopicInBeat(beat, throttle)

    async def _find(self, type_name: str, type_hash: str, topic: str) -> None:
        text = await self._context.descriptions.find(type_name, type_hash, topic)
        # What nobody describes is judged by its own limit.
        self._stamped[type_hash] = stamped = text is not None and _begins_with_stamp(text, type_hash)
        for compose in self._awaiting.pop(type_hash):
            if not stamped:
                compose()


def _begins_with_stamp(text: str, type_hash: str) -> bool:
    """Whether messages of a described type begin with a header, or with a time."""
    fields = read_description(text, type_hash).type_description.fields
    return bool(fields) and fields[0].type.type_id == NESTED and fields[0].type.nested_type_name in _BEGIN_WITH_STAMP
