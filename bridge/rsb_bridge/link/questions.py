"""Questions that the two sides of a link ask each other: topic lists, and descriptions of types."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import msgspec
import zstandard

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT, difference_of_texts, hash_of_text
from rsb_bridge.link.control_channel import entries_in_slices
from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.proposals import KINDS
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import MOST_LANES
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.ros.ros_graph import CALLED, graph_of
from rsb_bridge.tasks import NOT_TOO_EARLY
from rsb_bridge.wire.codec import MOST_TOPICS, pack_topics, topic_entries, unpack
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import AskType, ListTopics, TopicList, TypeText
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import TopicEntry

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Collection, Iterator, Sequence

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import ControlMessageBase

T = TypeVar("T")

QUESTIONS_KEPT = 8  # unanswered questions of the peer of one kind; further ones are ignored (PROTOCOL.md, 3)
_A_SECOND = 4.0  # answers to a peer, after `QUESTIONS_KEPT` at once. A round figure
_LISTS_A_SECOND = 1.0  # a list of a large graph takes 50 ms
_MOST_TYPES = 2 * MOST_LANES  # of one route, each with a line of an answer
_ANSWERED_WITHIN = 10.0  # s: the other side may have to ask three nodes, 2.5 s each (`ros.type_descriptions`)


@dataclass(slots=True, eq=False)
class _Asked(Generic[T]):
    """A question to the peer that has no answer yet."""

    question: ControlMessageBase
    answer: asyncio.Future[T]
    askers: int = 0  # callers that wait for it
    to_send: bool = True  # the next caller sends it: it has not been sent, or a caller has waited for too long


class Questions(Generic[T]):
    """The questions of one kind, in both directions of a link.

    A question and its answer belong to a connection: what the next one finds without an answer is asked again there.

    Args:
        answered_within: seconds that the peer has for an answer.
        a_second: answers to the peer in a second.
        newest_counts: whether the peer waits for the answer to its newest question only, so that none is given ahead.
    """

    def __init__(
        self, link: BaseLink, answered_within: float, *, a_second: float = _A_SECOND, newest_counts: bool = False
    ) -> None:
        self._link = link
        self._answered_within = answered_within
        self._a_second, self._newest_counts = a_second, newest_counts
        self._allowance = TokenBucket(1 if newest_counts else QUESTIONS_KEPT, a_second, link.context.now())
        self._asked: dict[int, _Asked[T]] = {}
        self._to_answer: dict[int, Callable[[], Awaitable[ControlMessageBase]]] = {}
        self._at: int | None = None  # the number of the question that is being answered
        self._answering = False

    async def ask(self, number: int, question: ControlMessageBase) -> T:
        """Return the peer's answer. All who ask the same before it arrives share it.

        Args:
            number: number of the question, which the answer repeats.

        Raises:
            LinkError: the link is lost, or the peer does not answer.
        """
        asked = self._asked.get(number)
        if asked is None:
            asked = self._asked[number] = _Asked(question, asyncio.get_running_loop().create_future())
        if asked.to_send:
            asked.to_send = False
            self._link.send(question)
        asked.askers += 1
        try:
            async with asyncio.timeout(self._answered_within):
                return await asyncio.shield(asked.answer)  # others may wait for it, and longer
        except TimeoutError:
            asked.to_send = True
            raise LinkError(Denied.NO_ANSWER()) from None
        finally:
            asked.askers -= 1
            # After an answer, a later question may have the same number: the id of a route.
            if not asked.askers and self._asked.get(number) is asked:
                del self._asked[number]

    def awaited(self, number: int) -> bool:
        """Whether anybody waits for the answer with a number."""
        return number in self._asked

    def answered(self, number: int, answer: T) -> None:
        """Take the peer's answer; nobody may wait for it any more."""
        asked = self._asked.pop(number, None)
        if asked is not None:
            asked.answer.set_result(answer)

    def answer(self, number: int, find: Callable[[], Awaitable[ControlMessageBase]]) -> None:
        """Answer the peer's question after its earlier ones.

        An answer costs more than a question: a question that is repeated before its answer is answered once, and too
        many waiting questions are ignored. Answers wait until there have been fewer in the last second.
        """
        if number in self._to_answer:
            return
        if self._newest_counts:
            self._to_answer = {at: each for at, each in self._to_answer.items() if at == self._at}
        elif len(self._to_answer) >= QUESTIONS_KEPT:
            return
        self._to_answer[number] = find
        if not self._answering:
            self._answering = True
            self._link.spawn(self._answer())

    async def _answer(self) -> None:
        try:
            while self._to_answer:
                now = self._link.context.now()
                if not self._allowance.take(1, now):
                    await asyncio.sleep((1 - self._allowance.left(now)) / self._a_second + NOT_TOO_EARLY)
                    continue
                number, find = next(iter(self._to_answer.items()))
                self._at = number
                message = await find()
                if self._to_answer.get(number) is find:  # otherwise the question's connection is over
                    del self._to_answer[number]
                    self._link.send(message)
        finally:
            self._to_answer.clear()
            self._at = None
            self._answering = False

    def suspend(self) -> None:
        """Answer none of the peer's questions: it asks again on the next connection."""
        self._to_answer.clear()

    def resume(self) -> None:
        """Ask again what has no answer."""
        for asked in self._asked.values():
            if asked.askers:
                asked.to_send = False
                self._link.send(asked.question)

    def disconnected(self) -> None:
        """Fail all questions, and answer none: the connection is over."""
        for asked in self._asked.values():
            asked.answer.set_exception(LinkError(Denied.LINK_LOST()))
            asked.answer.exception()  # the asker may have given up
        self._asked.clear()
        self._to_answer.clear()


class AskingExtension(Extension):
    """Asks and answers questions of one kind: what has no answer is asked again on the next connection."""

    _questions: Questions[Any]

    def suspend(self) -> None:
        self._questions.suspend()

    def resume(self) -> None:
        self._questions.resume()

    def disconnected(self) -> None:
        self._questions.disconnected()


class TypeQuestions(AskingExtension):
    """Asks the peer for descriptions of routes' types, and answers the same questions."""

    def __init__(self, link: BaseLink) -> None:
        self._link = link
        self._known = link.context.descriptions
        self.messages = {AskType: self._asked, TypeText: self._answered}
        self._questions: Questions[bytes] = Questions(link, _ANSWERED_WITHIN)

    def _asked(self, question: AskType) -> None:
        self._questions.answer(question.route, partial(self._find, question.route))

    def _answered(self, answer: TypeText) -> None:
        self._questions.answered(answer.route, answer.text)

    async def _find(self, route_id: int) -> TypeText:
        texts: list[str] = []
        route = self._link.ids.open_route(route_id)
        types, topic = ((), "") if route is None else (dict.fromkeys(route.half.facts.message_types), route.local_topic)
        for each in types:
            text = await self._known.find(each.name, each.type_hash, topic) if each.type_hash else None
            if text is not None and sum(map(len, texts)) + len(texts) + len(text) <= DESCRIPTION_LIMIT:
                texts.append(text)
        return TypeText(route=route_id, text=zstandard.compress("\n".join(texts).encode()) if texts else b"")

    async def describe(self, route: Route) -> str:
        """Return the description of a route's type.

        Raises:
            LinkError: neither side has the description, or this one has none and the peer cannot be asked, or does not
                answer.
        """
        carried = route.half.carried
        if not carried.type_hash:
            raise LinkError("its type's version is not known" if carried.type_name else "its type is not known yet")
        text = await self._known.find(carried.type_name, carried.type_hash, route.local_topic)
        if text is None and not (self._link.linked and route.id):
            raise LinkError(Denied.TYPE_NOT_HERE(type_name=carried.type_name))
        if text is None:
            self._keep(await self._questions.ask(route.id, AskType(route=route.id)), {carried.type_hash})
            text = self._known.known(carried.type_hash)
        if text is None:
            raise LinkError(Denied.TYPE_NOT_INSTALLED(type_name=carried.type_name))
        return text

    def compare(self, route_id: int, types: Sequence[TypeVersion], tell: Callable[[str], None]) -> None:
        """Implement `rsb_bridge.cdr.description.CompareTypes`."""
        installed = {each.type_hash: self._known.installed(each.name) for each in types}
        here = {type_hash: text for type_hash, text in installed.items() if text is not None}
        if not here:
            tell("")
            return

        async def compare() -> None:
            if None in map(self._known.known, here):
                with contextlib.suppress(LinkError):  # the texts that are known are compared
                    self._keep(await self._questions.ask(route_id, AskType(route=route_id)), here)
            there = {type_hash: self._known.known(type_hash) for type_hash in here}
            tell("; ".join(filter(None, (difference_of_texts(here[key], text) for key, text in there.items() if text))))

        self._link.spawn(compare())

    def _keep(self, compressed: bytes, type_hashes: Collection[str]) -> None:
        """Keep the texts in an answer that describe these types."""
        for text in (description_in(compressed) or "").split("\n", _MOST_TYPES):
            if (type_hash := hash_of_text(text)) in type_hashes:
                self._known.add(text, type_hash)


def description_in(compressed: bytes) -> str | None:
    """Return an answer's texts, one a line, without a check of their types, or None if it is empty or invalid."""
    try:
        return unpack(compressed, DESCRIPTION_LIMIT).decode() or None
    except (ProtocolError, UnicodeDecodeError):
        return None


_LISTED_WITHIN = 30.0
"""s. A made-up robot's list of 190 names had 35 kB, or 3.4 kB compressed, which may take seconds on a thin link."""
_MOST_BYTES = CONTROL_LIMIT - 4096  # the rest is for what is around the entries


class TopicLists(AskingExtension):
    """Asks the peer for the names in its graph, and answers the same question."""

    def __init__(self, link: BaseLink) -> None:
        self._link = link
        self._request = 0  # the number of the last question
        self.messages = {ListTopics: self._asked, TopicList: self._answered}
        self._questions: Questions[tuple[TopicEntry, ...]] = Questions(
            link, _LISTED_WITHIN, a_second=_LISTS_A_SECOND, newest_counts=True
        )

    def _asked(self, question: ListTopics) -> None:
        self._questions.answer(question.request, partial(self._find, question))

    def _answered(self, message: TopicList) -> Slices:
        if not self._questions.awaited(message.request):  # a list that nobody waits for is not even unpacked
            return 0
        entries: list[TopicEntry] = []
        last = yield from entries_in_slices(topic_entries(message.topics), entries.append)
        self._questions.answered(message.request, tuple(entries))
        return last

    async def _find(self, question: ListTopics) -> TopicList:
        return TopicList(question.request, await asyncio.to_thread(self._packed_entries))

    def _packed_entries(self) -> bytes:
        """Return the entries that the peer may know, as many as one message holds."""
        # For a longer text the other side would end the connection (PROTOCOL.md, 3).
        shown = [
            entry
            for entry in graph_of(self._link.context.ros, CALLED)
            if max(len(entry.topic), len(entry.type_name)) <= TEXT_LENGTH
            and self._link.end.shows(entry.topic, entry.kind)
        ]
        most = MOST_TOPICS
        while True:
            entries = [
                TopicEntry(e.topic, e.type_name, e.type_hash, e.qos, e.publishers, e.subscriptions, e.kind)
                for e in _shared_out(shown, most)
            ]
            if len(msgspec.msgpack.encode(entries)) <= _MOST_BYTES:
                return pack_topics(entries)
            most //= 2

    async def ask(self) -> list[TopicInfo]:
        """Return the topics and services of the peer's graph. All who ask before the answer arrives share it.

        Raises:
            LinkError: the link is lost, or the peer does not answer.
        """
        if not self._questions.awaited(self._request):
            self._request += 1
            self._link.spawn(self._outwait(self._request))
        entries = await self._questions.ask(self._request, ListTopics(self._request))
        return [
            TopicInfo(e.topic, e.type, e.type_hash, e.qos, e.publishers, e.subscriptions, kind)
            for e in entries
            if (kind := KINDS.get(e.kind)) is not None
        ]

    async def _outwait(self, request: int) -> None:
        """Wait although all who asked may give up: those who ask next get the list, and no second one is sent."""
        if self._questions.awaited(request):  # else it was answered before this began
            with contextlib.suppress(LinkError):
                await self._questions.ask(request, ListTopics(request))


def _shared_out(entries: list[TopicInfo], room: int) -> Iterator[TopicInfo]:
    """Yield a limited number of entries, which are sorted by kind, with a fair share for each kind."""
    shares: dict[str, int] = {}
    counts = sorted(Counter(entry.kind for entry in entries).items(), key=itemgetter(1))
    for kinds_before, (kind, count) in enumerate(counts):
        shares[kind] = min(count, room // (len(counts) - kinds_before))
        room -= shares[kind]
    for kind, of_kind in groupby(entries, attrgetter("kind")):
        yield from islice(of_kind, shares[kind])
