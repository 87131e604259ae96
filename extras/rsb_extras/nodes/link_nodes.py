"""Shows the nodes of each side of a link to the other one, while somebody looks there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import msgspec
import zstandard

from rsb_bridge.config.rights import Use, as_if_listed
from rsb_bridge.feature_api import LASTING, Cause, Extension, LinkError, Questions, TokenBucket, Verdict, Wording
from rsb_bridge.wire.codec import invalid, unpack
from rsb_extras.nodes import SHOW_NODES
from rsb_extras.nodes.graph_nodes import ROSOUT
from rsb_extras.nodes.node_book import NodeBook, moved
from rsb_extras.nodes.node_data import (
    PACKED_LIMIT,
    AskNode,
    AskNodes,
    NodeChanges,
    NodeDetails,
    NodesNews,
    NodeTold,
    moved_time,
)
from rsb_extras.nodes.node_watch import LOOKED_FOR, NodeWatch

if TYPE_CHECKING:
    from collections.abc import Generator

    from rsb_bridge.feature_api import Link, Rights, Route
    from rsb_bridge.model.session import Kind

_ANSWERED_WITHIN = 15.0
"""s. The first list of 500 nodes is 5 kB, which takes seconds on a thin line."""
_A_SECOND = 2.0  # answers of each kind
_BURST, _BYTES_A_SECOND = 4000, 1500
"""Bytes of changes, before they are compressed: 500 nodes whose figures all change take no more of a link."""
_NOBODY = frozenset({Cause.NO_PUBLISHER, Cause.PUBLISHER_GONE})
_LINE_IN_VERDICT = 120
_encode = msgspec.msgpack.Encoder().encode
_changes = msgspec.msgpack.Decoder(NodeChanges)
_details = msgspec.msgpack.Decoder(NodeDetails)

T = TypeVar("T")


class NodesText(Wording):
    """Reasons why a side's nodes are not shown, and what a topic without a publisher is told of."""

    NOT_SHOWN = "{owner} does not show its nodes to {peer}: leave show_nodes out {place}"
    LACKS = "{link}: the other side has no feature nodes: install all of rsb-console there"
    ENDED = "{text}: {node} ended {lasting} ago{line}"
    HAS_ENDED = "{text}: {node} has ended{line}"


class LinkNodes(Extension):
    """The nodes at both ends of a link.

    Attributes:
        book: the peer's nodes, as far as somebody here has looked.
    """

    def __init__(self, link: Link) -> None:
        self.messages = {
            AskNodes: self._asked,
            NodesNews: self._news,
            AskNode: self._asked_one,
            NodeTold: self._told_one,
        }
        self.explanation = self._explain
        self.book: Final = NodeBook(link.context.wall_ns() >> 16)
        self._link = link
        self._watch = link.context.shared(NodeWatch)
        self._lists: Questions[None] = Questions(link, _ANSWERED_WITHIN, a_second=_A_SECOND, newest_counts=True)
        self._ones: Questions[NodeDetails] = Questions(link, _ANSWERED_WITHIN, a_second=_A_SECOND)
        self._allowance = TokenBucket(_BURST, _BYTES_A_SECOND, link.context.now())
        self._peer_has = False
        self._looked_until = float("-inf")
        self._at = (0, 0)  # book and number of the peer's that this side has
        self._number = self._one_number = 0  # of the last questions
        self._taken = 0  # number of the question whose answer came last
        self._heard_at = 0.0
        self._asking = False
        self._endings = self._watch.endings

    # --- what somebody here looks at

    async def look(self) -> None:
        """Keep the peer's nodes up to date for some seconds; wait for them if nobody has looked just before.

        Raises:
            LinkError: the peer cannot be asked, or has never answered.
        """
        self._check()
        was_looked_at = self._link.context.now() < self._looked_until
        self._looked_until = self._link.context.now() + LOOKED_FOR
        if was_looked_at and self._at[0]:
            return
        try:
            await self._ask()
        except LinkError:
            if not self._at[0]:  # else `age` says how old that is which is known
                raise
        self._looked_until = self._link.context.now() + LOOKED_FOR

    @property
    def age(self) -> float:
        """Seconds since the peer's last word on its nodes."""
        return self._link.context.now() - self._heard_at

    def keep_looking(self) -> bool:
        """Look for some seconds more, without waiting; return whether the peer shows its nodes, as far as is known."""
        self._looked_until = self._link.context.now() + LOOKED_FOR
        return self._peer_has and not self.book.why_not

    async def one(self, node: str, topic: str) -> NodeDetails:
        """Return the details of one of the peer's nodes, or of the one that publishes a topic.

        Raises:
            LinkError: the peer cannot be asked, or does not answer.
        """
        self._check()
        self._one_number += 1
        found = await self._ones.ask(self._one_number, AskNode(self._one_number, node, topic))
        return in_time_of(round(self._link.context.now()), found)

    def _check(self) -> None:
        if not self._link.linked:
            raise LinkError(f"{self._link.name} is not linked: {self._link.down_reason}")
        if not self._peer_has:
            raise LinkError(NodesText.LACKS(link=self._link.name))

    def tick(self) -> None:
        if self._endings != self._watch.endings:
            self._endings = self._watch.endings
            self._explain_again()
        if self._peer_has and not self._asking and self._link.context.now() < self._looked_until:
            self._link.spawn(self._go_on())

    async def _go_on(self) -> None:
        try:
            await self._ask()
        except LinkError:
            return  # it is asked again, as long as somebody looks

    async def _ask(self) -> None:
        if not self._asking:  # else all who wait share the answer
            self._number += 1
        self._asking = True
        try:
            await self._lists.ask(self._number, AskNodes(self._number, *self._at))
        finally:
            self._asking = False

    def _news(self, message: NodesNews) -> Generator[int, None, int]:
        yield from ()
        # Over a thin line, an answer may come when nobody waits for it any more: it counts, as there is no newer one.
        if not self._taken < message.request <= self._number:
            return 0
        self._taken, self._heard_at = message.request, self._link.context.now()
        changes = _unpacked(message.packed, _changes)
        self._at = changes.book, changes.number
        self.book.why_not = changes.why_not
        self.book.take(changes, round(self._link.context.now()))
        self._lists.answered(message.request, None)
        return len(changes.nodes) + len(changes.processes) + len(changes.gone)

    def _told_one(self, message: NodeTold) -> Generator[int, None, int]:
        yield from ()
        if self._ones.awaited(message.request):
            self._ones.answered(message.request, _unpacked(message.packed, _details))
        return 1

    # --- what the peer looks at

    def _asked(self, question: AskNodes) -> None:
        self._lists.answer(question.request, lambda: self._list(question))

    async def _list(self, question: AskNodes) -> NodesNews:
        context = self._link.context
        if not self._not_shown:
            self._watch.look()
            await self._watch.ready()
        found = NodeChanges(0, 0, True, round(context.now()), why_not=self._not_shown)
        if not found.why_not:
            found = self._watch.book.changes(
                question.book, question.since, found.now, lambda size: self._allowance.take(size, context.now())
            )
            if not self._shows_lines:
                nodes = tuple(msgspec.structs.replace(each, line=None) for each in found.nodes)
                found = msgspec.structs.replace(found, nodes=nodes)
        return NodesNews(question.request, _packed(found))

    def _asked_one(self, question: AskNode) -> None:
        self._ones.answer(question.request, lambda: self._one(question))

    async def _one(self, question: AskNode) -> NodeTold:
        found = NodeDetails(round(self._link.context.now()))
        if not self._not_shown and (question.node or self._rights.shows(question.topic)):
            self._watch.look()
            await self._watch.ready()
            found = self._for_peer(self._watch.details(question.node, question.topic))
        return NodeTold(question.request, _packed(found))

    def _for_peer(self, details: NodeDetails) -> NodeDetails:
        """Leave out what the peer may not know."""
        rights = self._rights
        kinds: dict[str, Kind] = {"publishes": "topic", "hears": "topic", "serves": "service", "calls": "service"}
        every = {name: getattr(details, name) for name in kinds}
        shown = {
            name: tuple(each for each in every[name] if rights.shows(each.name, kind)) for name, kind in kinds.items()
        }
        left_out = details.left_out + sum(map(len, every.values())) - sum(map(len, shown.values()))
        details = msgspec.structs.replace(details, **shown, left_out=left_out)
        if self._shows_lines or details.state is None:
            return details
        return msgspec.structs.replace(details, lines=(), state=msgspec.structs.replace(details.state, line=None))

    @property
    def _rights(self) -> Rights:
        """The peer's rights to know of names."""
        # A client's own list says what the server may call there, and not what it may know of.
        return as_if_listed(self._link.end.rights)

    @property
    def _not_shown(self) -> str:
        """The reason why the peer may not see this side's nodes, or an empty string."""
        rights = self._link.end.rights
        if SHOW_NODES.of(rights):
            return ""
        return NodesText.NOT_SHOWN(owner=rights.owner, peer=rights.peer, place=rights.place)

    @property
    def _shows_lines(self) -> bool:
        return self._link.end.rights.refusal(Use(ROSOUT, "look")) is None

    # --- its life

    def connected(self) -> None:
        self._peer_has = True

    def suspend(self) -> None:
        self._lists.suspend()
        self._ones.suspend()

    def resume(self) -> None:
        self._lists.resume()
        self._ones.resume()

    def disconnected(self) -> None:
        self._peer_has = False
        self._taken = self._number
        self._lists.disconnected()
        self._ones.disconnected()
        self._at = (0, 0)
        self.book.begin()

    # --- why a topic does not flow

    def _explain_again(self) -> None:
        """Have verdicts made again that may name a node: it has ended later than the reason why they were made."""
        for route in self._link.routes.values():
            if route.outgoing and route.verdict().cause in (*_NOBODY, Cause.PUBLISHER_SILENT):
                route.judge_again()

    def _explain(self, route: Route, verdict: Verdict) -> Verdict | None:
        # The text goes to the peer, too, with the verdict.
        if not route.outgoing or self._not_shown:
            return None
        if verdict.cause in _NOBODY:
            ended = self._watch.ended_publisher(route.local_topic)
        elif verdict.cause == Cause.PUBLISHER_SILENT:
            ended = self._watch.ended_node(route.half.carried.endpoints)
        else:
            return None
        if ended is None:
            return None
        line = f": {ended.line[:_LINE_IN_VERDICT]}" if ended.line and self._shows_lines else ""
        if LASTING in verdict.text:  # it says for how long already
            text = NodesText.HAS_ENDED(text=verdict.text, node=ended.node, line=line)
            return Verdict(verdict.state, verdict.cause, text, verdict.since)
        text = NodesText.ENDED(text=verdict.text, node=ended.node, lasting=LASTING, line=line)
        return Verdict(verdict.state, verdict.cause, text, ended.at)


def _packed(content: NodeChanges | NodeDetails) -> bytes:
    return zstandard.compress(_encode(content))


def _unpacked(packed: bytes, decoder: msgspec.msgpack.Decoder[T]) -> T:
    """Return the content of an answer; raise `ProtocolError` if it is invalid."""
    try:
        return decoder.decode(unpack(packed, PACKED_LIMIT))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise invalid(error) from None


def in_time_of(now: int, details: NodeDetails) -> NodeDetails:
    """Return the peer's details with times of this side's clock."""
    shift = now - details.now
    lines = tuple(msgspec.structs.replace(each, at=moved_time(each.at, shift)) for each in details.lines)
    state, process = details.state, details.process
    if state is not None:
        state = moved(state, shift)
    if process is not None:
        process = msgspec.structs.replace(process, since=moved_time(process.since, shift))
    return msgspec.structs.replace(details, now=now, lines=lines, state=state, process=process)
