"""Recordings over one link: those of this side for its peer, and the peer's for this side's operators.

Pieces of a recording have an internal route of the lowest priority, on which the side that has the recording sends as
many as the other one has room for. That one keeps the place up to which it has all, and begins there anew after
whatever has happened: the sending side remembers nothing that counts.
"""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.feature_api import (
    AskingExtension,
    BytesDrain,
    BytesSource,
    DeniedUse,
    InternalRoutes,
    Level,
    LinkError,
    Questions,
    TokenBucket,
    Wording,
    sanitize_text,
)
from rsb_extras.courier import MAY_FETCH
from rsb_extras.courier.courier_messages import (
    PIECES,
    WINDOW,
    AskRecordings,
    BeginPieces,
    PiecesEnded,
    PiecesTaken,
    RecordingsAnswer,
)
from rsb_extras.courier.courier_records import MOST_RECORDINGS, PAGE
from rsb_extras.courier.courier_requests import RecordingGroup
from rsb_extras.courier.kept_recordings import FetchError, KeptProblem, KeptRecordings, may_read
from rsb_extras.courier.picking import picked
from rsb_extras.courier.pieces import Cutter, Piece, PieceError, PieceProblem, decode_piece, encode_piece
from rsb_extras.courier.slices import SLICE_HEAD, Pace, SliceJoiner
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rsb_bridge.feature_api import Link, Rights, Route
    from rsb_bridge.model.session import Direction
    from rsb_extras.courier.courier_records import ListedRecording
    from rsb_extras.courier.fetch_spool import PieceRow
    from rsb_extras.courier.kept_recordings import Kept

_LISTED_WITHIN = 30.0
"""s for a page, for which the other side may read recordings for 5 s. A round figure."""
_LISTS_A_SECOND = 1.0
_PAGE_BYTES = 128 << 10  # of a page, unless one recording has more: a tenth of a control message
_DEPTH = 16  # slices that may wait; 2 are under way
_BEGINS, _BEGINS_WITHIN = 20, 60.0
"""Orders of a peer for pieces that are followed at once, and then in so many s: each opens files."""
_SILENT, _LOOK_EVERY = 120.0, 5.0
"""s without a slice, while the link is up, after which this side begins anew. Round figures: a slice of 2 KiB
takes 0.4 s at 5 kB/s, and longer beside topics."""
_LATELY = 1.0
"""s after a topic's message in which slices make room for the next one. A round figure."""
_ENDED = "the recording is here"


class CourierCode(StrEnum):
    """Codes of the events that the courier logs; they stay as they are, for programs that read the log."""

    BEGAN = "courier.began"
    """The other side gets a recording of this side."""
    GIVEN = "courier.given"
    ASKED = "courier.asked"
    DONE = "courier.done"
    FAILED = "courier.failed"
    CANCELLED = "courier.cancelled"
    REMOVED = "courier.removed"
    """The oldest recording that was fetched is gone: `recordings.fetched` is full."""


_GETTING = "get recordings", MAY_FETCH.entry("true")


class CourierProblem(Wording):
    """The reason why a recording does not come, or not now."""

    NOT_LINKED = "{link} is not linked: {reason}"
    NOT_THERE = "the installation of {link} has no courier: install all of rsb-console there"
    NO_TOPIC = "{owner} does not let {peer} read {topic}"
    NO_SENDING = "{owner} takes no recording from {peer}: the side that gets it proposes the route"
    ONE_ROUTE = "recordings have a route already"
    NO_ROUTE = "this route carries no recordings"
    TOO_OFTEN = "recordings were asked for too often: one request more is taken each {seconds:g} s"
    NOT_OPENED = "the route for pieces was not opened: {reason}"
    LOST = "the link was lost"
    SILENT = "{link} sent nothing for {seconds:.0f} s"
    GAP = "a piece did not come"
    LIES = "{link} sent what it was not asked for: {error}"


class _Sending:
    """A run of pieces for the peer.

    Attributes:
        given: pieces that were made.
        taken: pieces that the peer has kept.
    """

    def __init__(self, order: BeginPieces) -> None:
        self.order = order
        self.given = self.taken = 0
        self.pace = Pace()
        self.news = asyncio.Event()
        self.task: asyncio.Task[None] | None = None

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait for news by which a condition holds."""
        while not condition():
            self.news.clear()
            await self.news.wait()


class _Receiving:
    """A run of pieces for this side.

    Attributes:
        arrivals: what has come and is not kept yet, or why no more comes.
        slices: those that have come.
        taken: pieces that are kept.
    """

    def __init__(self, run: int) -> None:
        self.run = run
        self.arrivals: asyncio.Queue[bytes | Exception] = asyncio.Queue()
        self.slices = self.taken = 0
        self.joiner = SliceJoiner()

    def end(self, error: Exception) -> None:
        self.arrivals.put_nowait(error)


class _Listed(NamedTuple):
    """Recordings that the peer has kept for a cause, the newest first and without their topics, when it listed them."""

    at: float
    kept: tuple[ListedRecording, ...]


class LinkCourier(AskingExtension):
    """One link's recordings, in both directions."""

    purpose = PIECES

    def __init__(self, link: Link) -> None:
        self.messages = {
            AskRecordings: self._asked,
            RecordingsAnswer: self._answered,
            BeginPieces: self._begin,
            PiecesTaken: self._taken,
            PiecesEnded: self._ended,
        }
        self._link = link
        self._context = link.context
        self._kept = link.context.shared(KeptRecordings)
        self._internal = InternalRoutes(link, link.table, PIECES, BytesSource, BytesDrain)
        self._questions: Questions[RecordingsAnswer] = Questions(link, _LISTED_WITHIN, a_second=_LISTS_A_SECOND)
        self._allowance = TokenBucket(_BEGINS, _BEGINS / _BEGINS_WITHIN, link.context.now())
        self._peer_has = False
        self._request = self._run = self._number = 0
        self._listed: _Listed | None = None
        self._sending: _Sending | None = None
        self._finding: asyncio.Future[Cutter] | None = None
        self._receiving: _Receiving | None = None
        self._route: Route | None = None
        self._drain: BytesDrain | None = None

    def connected(self) -> None:
        self._peer_has = True

    def disconnected(self) -> None:
        super().disconnected()
        self._peer_has = False
        self._end_sending()
        if self._receiving is not None:
            self._receiving.end(LinkError(CourierProblem.LOST()))

    # --- for the peer

    def denial(self, rights: Rights, *, sends: bool) -> DeniedUse | None:
        if sends:
            text = CourierProblem.NO_SENDING(owner=rights.owner, peer=rights.peer)
            return DeniedUse(text, "propose it from the side that receives")
        return None if MAY_FETCH.of(rights) else rights.lacks(*_GETTING)

    def refusal(self, name: str) -> str:
        own = [route for route in self._internal.proposed(here=False) if route.local_topic != name]
        return CourierProblem.ONE_ROUTE() if own else ""

    def _asked(self, ask: AskRecordings) -> None:
        self._questions.answer(ask.request, partial(self._page, ask))

    async def _page(self, ask: AskRecordings) -> RecordingsAnswer:
        rights = self._link.end.rights
        if not MAY_FETCH.of(rights):
            return RecordingsAnswer(ask.request, problem=sanitize_text(str(rights.lacks(*_GETTING))))
        left = [each for each in await self._kept.all(rights) if each.id > (ask.after or "")]
        page: list[ListedRecording] = []
        size = 0
        for each in left[:PAGE]:
            size += len(msgspec.msgpack.encode(each))
            if page and size > _PAGE_BYTES:
                break
            page.append(each)
        return RecordingsAnswer(ask.request, tuple(page), more=len(page) < len(left))

    def _begin(self, order: BeginPieces) -> None:
        self._end_sending()
        if not self._allowance.take(1, self._context.now()):
            self._end_run(order.run, CourierProblem.TOO_OFTEN(seconds=_BEGINS_WITHIN / _BEGINS), is_final=False)
            return
        sending = self._sending = _Sending(order)
        sending.task = self._link.spawn(self._send(sending))

    def _taken(self, taken: PiecesTaken) -> None:
        if self._sending is not None and self._sending.order.run == taken.run:
            self._sending.taken = max(self._sending.taken, taken.taken)
            self._sending.pace.heard(taken.slices, self._context.now())
            self._sending.news.set()

    def _end_sending(self) -> None:
        if self._sending is not None and self._sending.task is not None:
            self._sending.task.cancel()
        self._sending = None

    def _end_run(self, run: int, problem: str, *, is_final: bool) -> None:
        self._link.send(PiecesEnded(run, sanitize_text(problem), is_final))

    async def _send(self, sending: _Sending) -> None:
        order = sending.order
        try:
            source = await self._source(order.route)
            topics = self._allowed(order)
            wanted = order.wanted
            kept = await asyncio.to_thread(self._kept.find, wanted.recording, wanted.stamp)
            cutter = await self._cutter(order, topics, kept)
            self._log(kept, begins=True)
            await self._send_pieces(sending, source, cutter, topics, kept)
        except LinkError as error:
            self._end_run(order.run, str(error), is_final=False)
        except FetchError as error:
            self._end_run(order.run, str(error), is_final=True)

    async def _cutter(self, order: BeginPieces, topics: tuple[str, ...], kept: Kept) -> Cutter:
        """Find the place in a recording, one order after the other: of one that was given up, the thread goes on."""
        while self._finding is not None and not self._finding.done():
            await asyncio.wait((self._finding,))
        finding = self._finding = self._context.loop.run_in_executor(None, _cutter, order, topics, kept)
        finding.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody may wait by then
        await asyncio.wait((finding,))
        return finding.result()

    async def _source(self, route_id: int) -> BytesSource:
        route = self._link.ids.open_route(route_id)
        if route is None or route.proposed_here or not route.outgoing or route.purpose is not PIECES:
            raise LinkError(CourierProblem.NO_ROUTE())
        await self._internal.opened(route, route_id)  # the peer may have found it open before this side does
        if (source := self._internal.source(route)) is None:
            raise LinkError(CourierProblem.NO_ROUTE())
        return source

    def _allowed(self, order: BeginPieces) -> tuple[str, ...]:
        """Return the wanted topics that the peer may read; raises `FetchError` if it must not ask for the others."""
        rights = self._link.end.rights
        if not MAY_FETCH.of(rights):
            raise FetchError(str(rights.lacks(*_GETTING)))
        allowed = tuple(topic for topic in order.wanted.topics if may_read(rights, topic))
        denied = next((topic for topic in order.wanted.topics if topic not in allowed), None)
        if denied is not None and not order.wanted.heads:
            raise FetchError(CourierProblem.NO_TOPIC(owner=rights.owner, peer=rights.peer, topic=denied))
        return allowed

    async def _send_pieces(
        self, sending: _Sending, source: BytesSource, cutter: Cutter, topics: tuple[str, ...], kept: Kept
    ) -> None:
        is_last = False
        while not is_last:
            await sending.until(lambda: sending.given < sending.taken + WINDOW)
            piece = await asyncio.to_thread(_next_piece, cutter, kept)
            if self._allowed(sending.order) != topics:  # a reload may have taken a right away
                raise FetchError(KeptProblem.RIGHTS())
            if await asyncio.to_thread(kept.has_changed):
                raise FetchError(KeptProblem.CHANGED())
            sending.given, is_last = piece.number, piece.is_last
            await self._send_slices(sending, source, encode_piece(piece))
        self._log(kept, begins=False)

    async def _send_slices(self, sending: _Sending, source: BytesSource, piece: bytes) -> None:
        pace, at = sending.pace, 0
        while at < len(piece):
            pace.has_others = self._has_topics()
            await sending.until(lambda: pace.is_open)
            part = piece[at : at + pace.size]
            head = SLICE_HEAD.pack(sending.order.run & 0xFFFFFFFF, sending.given, at, len(piece))
            pace.sent(self._context.now())
            await asyncio.to_thread(source.send, head + part, self._context.wall_ns())
            if source.closed:
                raise LinkError(CourierProblem.NO_ROUTE())
            at += len(part)

    def _has_topics(self) -> bool:
        """Whether a message of another route has passed lately."""
        since = self._context.now() - _LATELY
        others = (route.meter.last for route in self._link.routes.values() if route.purpose is not PIECES)
        return any(last is not None and last > since for last in others)

    def _log(self, kept: Kept, *, begins: bool) -> None:
        text = f"{kept.path}: {self._link.peer_name} {'gets it' if begins else 'has got it'}"
        code = CourierCode.BEGAN if begins else CourierCode.GIVEN
        self._context.log(Level.INFO, code, text, link=self._link.name, from_peer=True)

    # --- for this side's operators

    def newest_kept(self, most: int) -> RecordingGroup:
        """Return what the peer has kept for a cause, as far as it has listed that already, the newest first."""
        if self._listed is None:
            return RecordingGroup(self._link.name, age=None)
        age = max(0.0, self._context.now() - self._listed.at)
        return RecordingGroup(self._link.name, self._listed.kept[:most], age=age)

    async def recordings(self) -> tuple[ListedRecording, ...]:
        """Return the peer's recordings.

        Raises:
            LinkError: the link is down, or the peer has no such feature, gives none, or does not answer.
        """
        found: dict[str, ListedRecording] = {}
        after: str | None = None
        while True:
            self._check_peer()
            self._request += 1
            answer = await self._questions.ask(self._request, AskRecordings(self._request, after))
            if answer.problem:
                raise LinkError(answer.problem)
            found.update((each.id, each) for each in answer.recordings)
            last = max((each.id for each in answer.recordings), default="")
            if not answer.more or len(found) >= MOST_RECORDINGS:
                listed = tuple(found.values())[:MOST_RECORDINGS]
                self._listed = _Listed(self._context.now(), _newest_kept(listed))
                return listed
            if last <= (after or ""):
                raise LinkError(CourierProblem.LIES(link=self._link.name, error="a page without end"))
            after = last

    def _answered(self, answer: RecordingsAnswer) -> None:
        self._questions.answered(answer.request, answer)

    def _check_peer(self) -> None:
        if not self._link.linked:
            raise LinkError(CourierProblem.NOT_LINKED(link=self._link.name, reason=self._link.down_reason))
        if not self._peer_has:
            raise LinkError(CourierProblem.NOT_THERE(link=self._link.name))

    async def receive(self, row: PieceRow) -> None:
        """Get what is missing of a row of pieces; one at a time.

        Raises:
            LinkError: the link was lost, or the peer cannot give it now. What has come is kept.
            FetchError: the peer does not give it, or lies.
            OSError: it cannot be written.
        """
        self._check_peer()
        route = await self._opened()
        self._run += 1
        receiving = self._receiving = _Receiving(self._run)
        try:
            order = BeginPieces(self._run, route.id, row.wanted, row.at, tuple(sorted(row.known)))
            self._link.send(order)
            while not row.is_whole:
                data = await self._arrival(receiving, route, order)
                piece = decode_piece(data)
                await asyncio.to_thread(row.add, piece, data)
                receiving.taken += 1
                self._tell(receiving)
        except PieceError as error:
            raise FetchError(CourierProblem.LIES(link=self._link.name, error=error)) from None
        finally:
            self._receiving = None

    def end(self) -> None:
        """Close the route for pieces: nothing more is to come."""
        route, self._route, self._drain = self._route, None, None
        if route is not None and self._link.routes.get(route.key) is route:
            self._link.table.remove(route, _ENDED)

    async def _arrival(self, receiving: _Receiving, route: Route, order: BeginPieces) -> bytes:
        silent, slices = 0.0, receiving.slices
        while silent < _SILENT:
            try:
                async with asyncio.timeout(_LOOK_EVERY):
                    arrived = await receiving.arrivals.get()
            except TimeoutError:
                if route.id != order.route:
                    raise LinkError(CourierProblem.LOST()) from None
                silent += _LOOK_EVERY if self._link.linked else 0.0
                if receiving.slices != slices:
                    silent, slices = 0.0, receiving.slices
                continue
            if isinstance(arrived, Exception):
                raise arrived
            return arrived
        raise LinkError(CourierProblem.SILENT(link=self._link.name, seconds=_SILENT))

    async def _opened(self) -> Route:
        """Return the route for pieces, once they can cross on it."""
        if self._route is None or self._link.routes.get(self._route.key) is not self._route:
            self._number += 1
            direction: Direction = "receive" if self._link.is_client else "transmit"
            self._route = self._internal.open(
                PIECES.route_name(str(self._number)), direction, depth=_DEPTH, compression="none", priority="low"
            )
        route = self._route
        drain = self._internal.drain(route) if await self._internal.opened(route) else None
        if drain is None:
            trouble = route.trouble()
            reason = str(route.life.refusal) or ("" if trouble is None else trouble.text)
            self.end()
            raise LinkError(CourierProblem.NOT_OPENED(reason=reason))
        if drain is not self._drain:
            self._drain = drain
            drain.taken = lambda data: self._context.call(partial(self._arrived, data))
        return route

    def _arrived(self, data: bytes) -> None:
        receiving, head = self._receiving, data[: SLICE_HEAD.size]
        if receiving is None or len(head) < SLICE_HEAD.size:
            return
        run, number, offset, size = SLICE_HEAD.unpack(head)
        if run != receiving.run & 0xFFFFFFFF:  # of an order before
            return
        receiving.slices += 1
        try:
            piece = receiving.joiner.add(number, offset, size, data[SLICE_HEAD.size :])
            if piece is not None and receiving.arrivals.qsize() >= WINDOW:
                raise PieceError(PieceProblem.TOO_MANY())
        except LookupError:
            self._stop(receiving, LinkError(CourierProblem.GAP()))
        except PieceError as error:
            self._stop(receiving, FetchError(CourierProblem.LIES(link=self._link.name, error=error)))
        else:
            if piece is not None:
                receiving.arrivals.put_nowait(piece)
            self._tell(receiving)

    def _stop(self, receiving: _Receiving, error: Exception) -> None:
        receiving.end(error)
        self._receiving = None

    def _tell(self, receiving: _Receiving) -> None:
        self._link.send(PiecesTaken(receiving.run, receiving.slices, receiving.taken))

    def _ended(self, ended: PiecesEnded) -> None:
        if self._receiving is not None and self._receiving.run == ended.run:
            self._receiving.end((FetchError if ended.is_final else LinkError)(ended.problem))


def _newest_kept(listed: Iterable[ListedRecording]) -> tuple[ListedRecording, ...]:
    kept = sorted((each for each in listed if each.cause), key=lambda each: each.begin, reverse=True)
    return tuple(msgspec.structs.replace(each, topics=()) for each in kept)


def _cutter(order: BeginPieces, topics: tuple[str, ...], kept: Kept) -> Cutter:
    wanted = order.wanted
    with _read_for_peer(kept):
        messages = picked(OpenRecording(kept.path), wanted, topics, order.at.time)
        denied = tuple(sorted({*wanted.topics} - {*topics}))
        return Cutter(order.run, messages, order.at, order.known, denied)


def _next_piece(cutter: Cutter, kept: Kept) -> Piece:
    with _read_for_peer(kept):
        return cutter.next()


@contextmanager
def _read_for_peer(kept: Kept) -> Iterator[None]:
    """Raise `FetchError` if a recording cannot be read; a peer is not told where it is."""
    try:
        yield
    except (RecordingError, OSError) as error:
        raise FetchError(kept.without_folder(str(error))) from None
