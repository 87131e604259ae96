"""The two sides of a link tell each other what their ROS graphs have: topics, and what can be called."""

from __future__ import annotations

import asyncio
from collections import Counter
from functools import partial
from itertools import groupby, islice
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Protocol

import msgspec

from rsb_bridge.link.control_channel import in_slices
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.proposals import KINDS
from rsb_bridge.link.questions import Questions
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.ros.ros_graph import CALLED, graph_of
from rsb_bridge.wire.codec import topic_entries
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import ListTopics, TopicList
from rsb_bridge.wire.records import TopicEntry

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable, Iterator, Sequence

    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.model.session import Kind
    from rsb_bridge.ros.ros_interface import RosInterface
    from rsb_bridge.wire.codec import TopicListParts
    from rsb_bridge.wire.messages import ControlMessage

_ANSWERED_WITHIN = 5.0
_MOST_ENTRIES = 4000
"""Of one list, which is one control frame: it holds some 5,000 of usual names, and 1,400 of the longest."""
_MOST_BYTES = CONTROL_LIMIT - 4096


class TopicLists:
    """Asks the peer for what its graph has, and answers when it asks for ours.

    Args:
        ros: this side's graph.
        shows: whether the peer may know of a name of a kind; called on another thread.
        send: sends a control message.
        spawn: runs a coroutine beside.
    """

    def __init__(
        self,
        ros: RosInterface,
        shows: Callable[[str, Kind], bool],
        send: Callable[[ControlMessage], None],
        spawn: Callable[[Coroutine[None, None, None]], object],
    ) -> None:
        self._ros = ros
        self._shows = shows
        self._request = 0  # the number of the last question
        self._questions: Questions[tuple[TopicEntry, ...]] = Questions(send, spawn, _ANSWERED_WITHIN)

    def disconnected(self) -> None:
        """The connection is over: nobody will answer."""
        self._questions.disconnected()

    def handle(self, message: ListTopics | TopicList | TopicListParts) -> Slices | None:
        """Answer the peer's question, or take its answer. Returns the work that is left, or None."""
        if not isinstance(message, ListTopics):
            return self._answered(message)
        self._questions.answer(message.request, partial(self._find, message))
        return None

    def _answered(self, message: TopicList | TopicListParts) -> Slices:
        if not self._questions.awaited(message.request):
            return 0
        entries: list[TopicEntry] = []
        last = yield from in_slices(topic_entries(message), entries.append)
        self._questions.answered(message.request, tuple(entries))
        return last

    async def _find(self, question: ListTopics) -> TopicList:
        kinds = [kind for kind in CALLED if kind in question.kinds]
        return TopicList(question.request, tuple(await asyncio.to_thread(self._local_entries, kinds)))

    def _local_entries(self, kinds: Sequence[Kind]) -> list[TopicEntry]:
        """What the peer may know of, as much as one message holds."""
        shown = [
            entry
            for entry in graph_of(self._ros, kinds)
            if max(len(entry.topic), len(entry.type_name)) <= TEXT_LENGTH and self._shows(entry.topic, entry.kind)
        ]
        most = _MOST_ENTRIES
        while True:
            entries = [
                TopicEntry(e.topic, e.type_name, e.type_hash, e.qos, e.publishers, e.subscriptions, e.kind)
                for e in _shared_out(shown, most)
            ]
            if len(msgspec.msgpack.encode(entries)) <= _MOST_BYTES:
                return entries
            most //= 2

    async def ask(self) -> list[TopicInfo]:
        """What the peer's graph has. Who asks while an answer is awaited gets the same answer.

        A peer that carries no calls answers with its topics.

        Raises:
            LinkError: the link is lost meanwhile, or the peer does not answer.
        """
        if not self._questions.awaited(self._request):
            self._request += 1
        entries = await self._questions.ask(self._request, ListTopics(self._request, CALLED))
        return [
            TopicInfo(e.topic, e.type, e.type_hash, e.qos, e.publishers, e.subscriptions, kind)
            for e in entries
            if (kind := KINDS.get(e.kind)) is not None
        ]


class Asked(Protocol):
    """A link, as far as its peer's graph is asked for."""

    name: str
    topic_lists: TopicLists

    @property
    def linked(self) -> bool:
        """Whether the peer is connected and authenticated."""
        ...

    @property
    def down_reason(self) -> str:
        """Why it isn't linked."""
        ...


async def topics_of_peer(links: Iterable[Asked], name: str) -> list[TopicInfo]:
    """What can be bridged on the other side of the link of that name.

    Raises:
        LinkError: there is no such link, or no peer now, or it does not answer.
    """
    link = next((each for each in links if each.name == name), None)
    if link is None:
        raise LinkError(f"there is no link {name!r}")
    if not link.linked:
        raise LinkError(f"{link.name} is not linked: {link.down_reason}")
    try:
        return await link.topic_lists.ask()
    except LinkError as error:
        raise LinkError(f"{link.name}: {error}") from None


def _shared_out(entries: list[TopicInfo], room: int) -> Iterator[TopicInfo]:
    """At most so many of entries that are by kind: no kind is left out because there is so much of another one."""
    shares: dict[str, int] = {}
    counts = sorted(Counter(entry.kind for entry in entries).items(), key=itemgetter(1))
    for kinds_before, (kind, count) in enumerate(counts):
        shares[kind] = min(count, room // (len(counts) - kinds_before))
        room -= shares[kind]
    for kind, of_kind in groupby(entries, attrgetter("kind")):
        yield from islice(of_kind, shares[kind])
