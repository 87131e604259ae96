"""The data streams of a link: each pair of them carries the messages of all routes that name its port.

One stream of a pair carries small messages, the other one all messages of routes with large ones. Two, because a packet
that is lost holds up all that follows on its stream: with 2 % loss, joint states next to a camera take 22 ms, and 51 ms
over Zenoh, where all share one connection (bench/README.md, *Thin links*). Not one for each route, because then the
kernel would decide which topic goes next.

A lost stream is opened again. On the new one, its routes first send the messages that the other side has not
acknowledged, then those in their queues. The other side drops the messages that it has already, so that each arrives
once and in order. A best-effort topic sends nothing again. Routes of topics that have to be armed are closed instead,
and open again: a robot must notice the break.

A transport whose streams are scarce (Bluetooth: one for each channel) has one stream for both, and on the link's own
channel that is the control connection's.
"""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections import deque
from typing import TYPE_CHECKING, Protocol, TypeAlias

from rsb_bridge.channel.channel import REOPENS, Counts, DataChannel, ReceivingChannel
from rsb_bridge.channel.scheduler import Carrier, SendingChannel
from rsb_bridge.channel.window import ReceiptBook, ReceiptCounter
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.fates import Fate, Lost
from rsb_bridge.model.reason import NO_REASON, EndCode, Reason
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.framing import CONTROL_LIMIT, DATA, HEADER, LENGTH, MORE, MOVED, RESUMED, FrameReader
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.channel.scheduler import Scheduler
    from rsb_bridge.transport.transport import StreamTransport
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.messages import Receipts

_OF_ROUTES = (DATA, MOVED, RESUMED)
_KIND_AND_ROUTE = struct.Struct(">BxI")  # the part of `HEADER` that tells a frame's route
Sent: TypeAlias = "tuple[StreamSender, Sequence[Message]]"
"""Messages of a route that leave together."""
_GATHERED = 64 * 1024  # bytes of messages that are gathered at the most, as of what a stream holds
LARGE = 16 * 1024
"""Bytes of a message that takes the stream for large ones (bench/README.md, *Constants of data streams*)."""

# Of lost streams. Round figures.
_AT_ONCE, _STEADY_AFTER = 3, 15.0
"""Losses of a pair upon which its streams are opened again at once, unless they lasted for so many s: from then on each
attempt waits longer. Three, because a firewall that forgets both shows it one by one."""
_FIRST_DELAY, _LONGEST_DELAY = 0.9, 5.0  # s between such attempts: a path that is back has its streams within 5 s
_FAILING_AFTER = 10.0
"""s without a stream on which anything gets through, after which that is a fault. Routes wait at least as long."""
_SHORTEST_PAUSE, _LONGEST_PAUSE = 5.0, 60.0
"""s until a stream is opened that no route of this side waits for, and that the other side may refuse."""
_DEAD_AFTER, _UNHEARD = 10.0, 2.5
"""s without a receipt for bytes that the kernels have exchanged, after which a stream is given up, as long as the
control connection, which brings the receipts, was never silent for so many s: something acknowledges, and passes
nothing on. Receipts come once a second."""


class RouteNumbers(Protocol):
    """The ids of a link's routes."""

    def awaits_channel(self, route_id: int) -> bool:
        """Whether a route is open under an id, and has no channel yet."""

    def is_closed_id(self, route_id: int) -> bool:
        """Whether a route was open under an id, and is closed."""


class StreamsOwner(Protocol):
    """The connection that data streams belong to."""

    keys: DataKeys
    scheduler: Scheduler
    book: ReceiptBook

    @property
    def outlive(self) -> float:
        """Seconds for which what is lost may be opened again."""

    @property
    def ids(self) -> RouteNumbers: ...

    def open_streams(self, transport: StreamTransport, port: int) -> None:
        """Open the streams that routes with that port lack; a server waits for its client."""


class DataStream(Carrier, StreamHandler):
    """A stream, whose bytes in both directions are counted for the link's window.

    Args:
        stream: that the server has accepted.
        number: names it in receipts.

    Attributes:
        acknowledged: bytes that have arrived.
        resumed: bytes with which routes have said that they resume on it.
        unwritten: messages in the next bytes that are written.
        gathered: messages that leave together (`gathers`).
        gathered_size: bytes of these.
        counter: counts received bytes.
    """

    def __init__(self, stream: Stream, number: int, pair: StreamPair) -> None:
        super().__init__(pair.scheduler)
        self.stream = stream
        self.number = number
        self.sent = self.acknowledged = self.resumed = 0
        self.unwritten: list[Sent] = []
        self.counter = ReceiptCounter()
        self.gathered: list[Sent] = []
        self.gathered_size = 0
        self._pair = pair
        self._kept: deque[tuple[int, list[Sent]]] = deque()  # by how many bytes have left with them
        self._settled = 0  # bytes that are not in transit: acknowledged or written off
        self._frames = FrameReader(CONTROL_LIMIT, pair.keys.budget)
        self._held: Sequence[memoryview] = ()
        self._asked = 0
        pair.book.add(number, self.counter)

    @property
    def congested(self) -> bool:
        return self.stream.congested or self.over or self.acknowledged < self._settled

    @property
    def in_transit(self) -> int:
        return self.sent - self._settled

    @property
    def delivers(self) -> bool:
        """Whether anything of a route's has arrived on it, or nothing has to."""
        return self.acknowledged > self.resumed or self.sent <= self.resumed

    def write_off(self) -> None:
        self._settled = self.sent

    def write(self, data: bytes | memoryview, now: float) -> None:
        if self.sent == self._settled:
            self.moved_at = now
        self.sent += len(data)
        if self.unwritten:
            self._kept.append((self.sent, self.unwritten))
            self.unwritten = []
        self.stream.write(data)
        if self.stream.congested and isinstance(data, memoryview):
            self._pair.keys.scratch.lost()  # the stream's, until it has sent it

    def gathers(self) -> bool:
        """Whether the next messages leave with those of other routes that come in this moment: then put them there.

        They are neither sealed nor counted before.
        """
        joined = self.stream.joined
        if joined is None or not joined.is_open:
            return False
        if self.gathered_size >= _GATHERED:
            self.write_gathered()
        if not self.gathered:
            joined.gather(self.write_gathered)
        self.spare = min(_GATHERED - self.gathered_size, self.scheduler.spare_of_one())
        return True

    def write_gathered(self) -> None:
        gathered, scheduler = self.gathered, self.scheduler
        self.spare = 0
        if not gathered:
            return
        self.gathered = []
        scheduler.gathered -= self.gathered_size
        self.gathered_size = 0
        parts = [sender.seal(batch) for sender, batch in gathered]
        scheduler.charge(self, [(sender, len(data)) for (sender, _), data in zip(gathered, parts, strict=True)])
        self.unwritten += gathered
        scheduler.write(self, b"".join(parts))

    def unacknowledged(self) -> Iterator[Sent]:
        """Yield the messages that may not have arrived, oldest first."""
        self.write_gathered()
        for _, sent in self._kept:
            yield from sent

    def closed(self, reason: Reason) -> None:
        # Its routes have lost it, also if this side gave it up.
        self._pair.lose(self, reason if reason.broke else Reason(reason.text, EndCode.BROKE))

    def end(self, reason: str) -> None:
        """Close it; nothing more is heard of it."""
        self.write_gathered()
        self._frames.close()
        self._held = ()
        self.stream.handler = StreamHandler()
        self.stream.abort(reason)

    # --- frames

    def received(self, data: bytes) -> None:
        try:
            self._take(self._frames.feed(data), len(data))
        except (ProtocolError, SealError) as error:
            self._pair.drop(self, Reason(str(error), EndCode.BROKE))

    def received_frame(self, frame: memoryview) -> None:
        """Take a frame that came on a control connection, without its length; raises as `receive`."""
        self._take((frame,), LENGTH.size + len(frame))

    def _take(self, frames: Sequence[memoryview], size: int) -> None:
        """Take frames that came with `size` bytes."""
        if self._held:
            self._held = [*self._held, *frames]
            size -= _bytes_of(frames)
        else:
            self.receive(frames)
            if self._held:
                size -= _bytes_of(self._held)
        self.count(size)

    def receive(self, frames: Sequence[memoryview]) -> None:
        """Hand frames to their routes, and hold frames that have to wait for another stream, or for their route.

        Held frames are not acknowledged: they are gone if this stream is lost.

        Raises:
            ProtocolError: they break the format.
            SealError: a seal is invalid.
        """
        at, count, ends = 0, len(frames), self._pair.ends
        least, key_of = HEADER.size, _KIND_AND_ROUTE.unpack_from
        while at < count:
            if len(frames[at]) < least:
                raise ProtocolError(Broken.DATA_FRAME_TOO_SHORT(length=len(frames[at]), header=least))
            kind, route_id = key = key_of(frames[at])
            end = at + 1
            while end < count and len(frames[end]) >= least and key_of(frames[end]) == key:
                end += 1
            route_end = ends.get(route_id)
            if route_end is not None and kind in _OF_ROUTES:
                passed = route_end.received(self, kind, frames[at:end])
            else:
                passed = self._pair.is_unneeded(kind, route_id)
            if not passed:
                self._held = frames[at:]
                self.stream.pause_reading()
                return
            at = end

    def take_held(self) -> None:
        """Take the frames that are held, if what they waited for has come."""
        if not self._held:
            return
        held, self._held = self._held, ()
        try:
            self.receive(held)
        except (ProtocolError, SealError) as error:
            self._pair.drop(self, Reason(str(error), EndCode.BROKE))
            return
        self.count(_bytes_of(held) - _bytes_of(self._held))
        if not self._held:
            self.stream.resume_reading()

    # --- receipts

    def passes_nothing(self, since: float) -> bool:
        """Whether it owes bytes since before that time (s), no receipt has come, and its kernel repeats none."""
        if self.sent <= self.acknowledged or self.moved_at >= since or self.over:
            return False
        packets = self.stream.packets()
        return packets is None or not packets.tries

    def count(self, size: int) -> None:
        """Count received bytes, and send a receipt if one is due."""
        counter = self.counter
        counter.count += size
        if counter.count >= counter.due:
            self._pair.book.report()

    def receipt(self, count: int) -> int:
        """Take the peer's receipt of the first `count` bytes; return how many are no longer in transit by it."""
        acknowledged = min(count, self.sent)  # a peer that claims more gains nothing
        if acknowledged <= self.acknowledged:
            return 0
        self.acknowledged = acknowledged
        while self._kept and self._kept[0][0] <= acknowledged:
            self._kept.popleft()
        self.moved_at = self._pair.book.now()
        gained = max(0, acknowledged - self._settled)
        self._settled += gained
        return gained

    def ask(self, every: int) -> None:
        """Have the peer send a receipt after every `every` bytes from now on."""
        # The window changes with each receipt: to ask each time would cost a message for each receipt.
        if every >= 2 * self._asked or 2 * every <= self._asked:
            self._asked = every
            self._pair.book.ask(self.number, every)


def _bytes_of(frames: Sequence[memoryview]) -> int:
    return sum([LENGTH.size + len(frame) for frame in frames])


def take_receipts(receipts: Receipts, streams: Iterable[DataStream], scheduler: Scheduler) -> None:
    """Take a message with the peer's receipts and intervals; entries of streams that have ended may cross that."""
    by_number = {each.number: each for each in streams}
    for number, every in receipts.every:
        if number in by_number:
            by_number[number].counter.set_interval(every)
            # As many may have come already, and the peer's window may be full: no further bytes would make one due.
            by_number[number].count(0)
    # Together: by the receipt of a quiet stream alone, the bytes that a busy one has sent since its last receipt would
    # seem to wait on the path.
    received = [(by_number[number], count) for number, count in receipts.received if number in by_number]
    if received:
        every = scheduler.acknowledge(sum([stream.receipt(count) for stream, count in received]))
        for stream, _ in received:
            stream.ask(every)
    for number in receipts.given_up:
        if number in by_number:
            by_number[number].closed(Reason("given up by the other side", EndCode.BROKE))


class StreamPair:
    """The streams for small and for large messages of the routes that name one port.

    If the stream of large messages is lost, as where only large packets are, the routes on the other one stay. Without
    the stream of small messages, both end. Routes of a lost stream resume once both are open (`resume_routes`), as long
    as an association outlives its connection: until then, nothing closes a route that may resume. The pair itself
    suspends and resumes with the link's connection.

    Attributes:
        small: the stream of small messages, or None until it is accepted.
        large: that of large messages, or the same one.
        stuck: the streams on which nothing got through at the last tick.
        is_failing: whether no streams came for a while that delivered anything, at the last tick.
        over: whether they have ended, and routes need another pair.
        kept: whether they stay open while no route uses them.
        transport: theirs.
        port: that its routes name.
    """

    def __init__(self, owner: StreamsOwner, transport: StreamTransport, port: int) -> None:
        self.small: DataStream | None = None
        self.large: DataStream | None = None
        self.stuck: Sequence[DataStream] = ()
        self.is_failing = False
        self.over = False
        self.kept = True
        self.scheduler, self.book, self.keys = owner.scheduler, owner.book, owner.keys
        self.ends: dict[int, _StreamEnd] = {}
        self._owner, self.transport, self.port = owner, transport, port
        self._failing_since: float | None = None  # since the first of the losses that nothing got through in between
        self._opened_at = self._asked_at = float("-inf")  # when both were last open, and asked for
        self._retry_at = 0.0
        self._at_once = _AT_ONCE  # attempts that need not wait
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._unheard_at = float("-inf")  # when the control connection was silent last
        self._lost_for = NO_REASON
        self._pause = _SHORTEST_PAUSE

    @property
    def ready(self) -> bool:
        return not any(self.lacks())

    @property
    def trouble(self) -> tuple[object, ...]:
        """All that `_StreamEnd.trouble` of its routes depends on."""
        return tuple([each.number for each in self.stuck]), 0 if self.ready else len(self._waiting()), self.is_failing

    def lacks(self) -> tuple[bool, bool]:
        """Return whether the streams of small and of large messages are not open."""
        return self.small is None or self.small.over, self.large is None or self.large.over

    def add(self, stream: Stream, number: int, *, large: bool, small: bool) -> DataStream:
        """Use an accepted stream for large messages, for small ones, or for both."""
        added = DataStream(stream, number, self)
        if small:
            self.small = added
        if large:
            self.large = added
        return added

    def streams(self) -> tuple[DataStream, ...]:
        """Return the open streams, each once: on RFCOMM one stream is both."""
        return tuple(dict.fromkeys([each for each in (self.small, self.large) if each is not None and not each.over]))

    def forget(self, route_id: int) -> None:
        """Forget a route, which is closed; the last one closes streams that are not the link's own."""
        self.ends.pop(route_id, None)
        self.end_unused()

    def end_unused(self) -> None:
        """Close streams that no route uses and that are not the link's own; maybe only one of them is open."""
        if not self.ends and not self.kept and not self.over:
            self.end("no topic uses it any more")

    def is_unneeded(self, kind: int, route_id: int) -> bool:
        """Whether frames without an end of a route are not needed any more; otherwise they have to wait for it.

        Raises:
            ProtocolError: nothing of that kind or route is to be expected.
        """
        known = kind in _OF_ROUTES
        if known and self._owner.ids.awaits_channel(route_id):
            return False  # the control message that opens its channel comes by another stream
        if not known or not self._owner.ids.is_closed_id(route_id):
            raise ProtocolError(Broken.FRAME_OF_UNKNOWN_ROUTE(kind=kind, route=route_id))
        return True  # it was on the way while the route was closed

    def take_held(self) -> None:
        """Take the frames that are held, if what they waited for has come."""
        for stream in self.streams():
            stream.take_held()

    def lose(self, stream: DataStream, reason: Reason) -> None:
        """Handle the loss of one stream: its routes resume on the next one, if they may, or are closed."""
        if self.over or stream.over:
            return
        now = self.book.now()
        if self._failing_since is None or stream.acknowledged > stream.resumed:
            self._failing_since = now
        if self.ready:  # else it belongs to the loss before
            self._plan_attempt(now)
        resumes = now - self._failing_since <= self._patience
        self.drop(stream, reason, resumes=resumes)
        if resumes and self.ends:
            self._pause = _SHORTEST_PAUSE
            if now >= self._retry_at:
                self._owner.open_streams(self.transport, self.port)

    @property
    def _patience(self) -> float:
        """Seconds for which routes wait for streams that deliver."""
        return max(_FAILING_AFTER, self._owner.outlive)

    def _plan_attempt(self, now: float) -> None:
        """Set when streams are opened again that were lost at `now` (s): later each time if they are lost at once."""
        if now - self._opened_at >= _STEADY_AFTER:
            self._at_once = _AT_ONCE
            self._backoff.reset()
        self._retry_at = now
        if self._at_once:
            self._at_once -= 1
        else:
            self._retry_at += self._backoff.next()

    def drop(self, stream: DataStream, reason: Reason, *, resumes: bool = False) -> None:
        """End one stream, and close its routes: without `lose`, the peer has broken the format on it.

        Args:
            resumes: routes that may resume wait for another stream instead.
        """
        if self.over or stream.over:
            return
        self._lost_for = reason
        lost = self.streams() if stream is self.small else (stream,)
        for sender, batch in (sent for each in lost for sent in each.unacknowledged()):
            sender.unacknowledged += batch
        self._end(lost, reason.text)
        for end in tuple(self.ends.values()):  # each one that is lost leaves
            if end.uses(stream):
                if resumes and end.route.fates[Lost.STREAM] is not Fate.CLOSES:
                    end.suspend()
                else:
                    end.route.channel_lost(reason)
        if stream is self.small and not self._waiting():
            self.over = True

    def _waiting(self) -> list[_StreamEnd]:
        """Return the routes that wait for a stream in place of a lost one."""
        return [end for end in self.ends.values() if end.is_suspended]

    def suspend(self, reason: Reason) -> None:
        """End both streams, as the link has lost its connection; all routes wait. Armed ones are closed already."""
        if self.over:
            return
        for each in self.streams():
            self.drop(each, reason, resumes=True)
        if not self.ends:
            self.over = True

    def resume(self, keys: DataKeys) -> None:
        """Take the keys of the link's next connection. Routes resume once streams are added, or at once on its own."""
        self.keys = keys
        self._failing_since = self._asked_at = self.book.now()  # the wait for streams begins
        self._opened_at, self._retry_at = float("-inf"), self._asked_at + _FIRST_DELAY
        self._lost_for = NO_REASON  # the log has the link's loss
        for end in self.ends.values():
            end.take_keys(keys)
        self.resume_routes()

    def resume_routes(self) -> Reason:
        """Have the routes whose streams were lost resume, if both are open now.

        Returns:
            Why they were lost, or an empty reason if none was.
        """
        waiting = self._waiting()
        if not waiting or not self.ready:
            return NO_REASON
        self._opened_at = self.book.now()
        for end in waiting:
            end.resume()
        self.take_held()
        self.scheduler.run()
        return self._lost_for

    def failed(self, reason: Reason) -> None:
        """Record why streams could not be opened. Routes that wait for them go on waiting, up to `_patience`."""
        self._lost_for = reason
        self._retry_at = self.book.now() + self._backoff.next()

    @property
    def lost_for(self) -> str:
        """The reason why the last streams were lost, or never opened."""
        return self._lost_for.text or "none came"

    def _give_up(self) -> None:
        """Close the routes that wait for a stream in place of a lost one."""
        for end in self._waiting():
            end.ready = False  # it is no longer connected, and is shown so
            end.route.channel_lost(self._lost_for or Reason("no data connection came", EndCode.BROKE))

    def tick(self, control_quiet: float = 0.0) -> None:
        """Take held frames, and give up streams that pass nothing or do not come. Called once a second.

        Args:
            control_quiet: s since the last byte on the control connection.
        """
        self.take_held()  # a route that frames wait for may be closed
        now = self.book.now()
        if control_quiet > _UNHEARD:
            self._unheard_at = now
        since = now - _DEAD_AFTER
        for each in self.streams():
            if self._unheard_at < since and each.passes_nothing(since):
                self.book.give_up(each.number)
                self.lose(each, Reason("nothing got through for 10 s, check firewalls and proxies", EndCode.BROKE))
        # The kernel is asked here, and not by each of hundreds of routes.
        self.stuck = [each for each in self.streams() if each.stream.stuck]
        if self.ready and all(each.delivers for each in self.streams()):
            self._failing_since = None
        failing_for = 0.0 if self._failing_since is None else now - self._failing_since
        self.is_failing = failing_for >= _FAILING_AFTER
        if not self.ends or self.ready:
            return
        if not self._waiting():  # a route of the other side may need it
            if now - self._asked_at > self._pause:
                self._asked_at, self._pause = now, min(2 * self._pause, _LONGEST_PAUSE)
                self._owner.open_streams(self.transport, self.port)
        elif failing_for > self._patience:
            self._give_up()
        elif now >= self._retry_at:
            self._owner.open_streams(self.transport, self.port)

    def end(self, reason: str) -> None:
        """End both streams; the routes hear nothing."""
        self.over = True
        self._end(self.streams(), reason)

    def _end(self, streams: Sequence[DataStream], reason: str) -> None:
        for each in streams:  # all before the first ends, which gives its room in the window to the others
            each.over = True
        for each in streams:
            each.end(reason)
            self.book.forget(each.number)
            self.scheduler.remove(each)


class _StreamEnd(DataChannel):
    """The base of both ends.

    Args:
        pair: the streams, which are ready. Frames may have come already: call `StreamPair.take_held` once the route
            has this channel.

    Attributes:
        is_suspended: whether its stream is lost, and it waits for the next one.
    """

    ready = True

    def __init__(self, pair: StreamPair, route: RouteSink) -> None:
        assert pair.small is not None
        self.route = route
        self.is_suspended = False
        self._pair = pair
        self._small = pair.small
        self._route_id = route.id
        pair.ends[route.id] = self

    def trouble(self) -> Verdict | None:
        pair = self._pair
        if pair.is_failing and (
            self.is_suspended or any(self.uses(each) for each in pair.streams() if not each.delivers)
        ):
            text = (
                f"no data connection of it delivers anything ({pair.lost_for}), though the link is up: "
                "check firewalls and NAT between the two sides"
            )
            return Verdict(State.DOWN, Cause.NO_PATH, text)
        if self.is_suspended:
            return Verdict(State.WAITING, Cause.AWAITS_LINK, REOPENS)
        stuck = self._pair.stuck  # nearly never any
        if not (stuck and any(self.uses(each) for each in stuck if not each.over)):
            return None
        text = "nothing gets through its data connection now: check the network and firewalls between the two sides"
        return Verdict(State.DOWN, Cause.NO_PATH, text)

    def close(self, reason: str) -> None:
        self._pair.forget(self._route_id)

    def uses(self, stream: DataStream) -> bool:
        """Whether the route's messages are on a stream."""
        return stream is self._small

    def suspend(self) -> None:
        """Wait for a stream in place of the lost one."""
        self.is_suspended = True

    def take_keys(self, keys: DataKeys) -> None:
        """Use the keys of the next connection: each end has one for its direction."""

    def resume(self) -> None:
        """Go on on the new stream."""
        assert self._pair.small is not None
        self._small, self.is_suspended = self._pair.small, False

    def _next_stream(self) -> DataStream:
        """Return the stream in place of the lost one. After the loss of both, a route begins on the small one again."""
        found = self._pair.small if self._small.over else self._pair.large
        assert found is not None
        return found

    @abstractmethod
    def received(self, stream: DataStream, kind: int, frames: Sequence[memoryview]) -> bool:
        """Take the route's frames of one kind from a stream; return False if they have to wait for another stream.

        Raises:
            ProtocolError: they break the format.
            SealError: a seal is invalid.
        """


class StreamSender(_StreamEnd, SendingChannel):
    """The sending end: it gives the scheduler what the route's queue holds, when its turn comes."""

    via: DataStream

    def __init__(self, pair: StreamPair, route: RouteSink) -> None:
        super().__init__(pair, route)
        SendingChannel.__init__(self, route, self._small)
        self.unacknowledged: list[Message] = []  # on lost streams
        self._writer = pair.keys.stream_writer(route.id)
        self.seal = self._writer.write_many
        self._at = 0  # bytes of the first message that are sent
        self._again = 0  # of the waiting messages: are sent again

    def send(self, batch: Sequence[Message]) -> None:
        if self._in_turn:
            self._messages += batch
            return
        scheduler, via = self._scheduler, self.via
        size = len(batch[0][0]) if len(batch) == 1 else sum([len(payload) for payload, _, _ in batch])
        if size <= scheduler.chunk and (size < LARGE or not self._must_move(size)):
            # No turn is due, so there is none to wait for: the hot path.
            if size < via.spare or via.gathers():
                via.gathered.append((self, batch))
                via.gathered_size += size
                via.spare -= size
                scheduler.gathered += size
                return
            data = self.seal(batch)
            scheduler.charge(via, ((self, len(data)),))
            via.unwritten.append((self, batch))
            via.write(data, scheduler.count(len(data)))
            return
        self._wait(batch)

    def take_turn(self, limit: int) -> bytes | memoryview:
        if not self._messages and not self._fill():
            return b""
        payload = self._messages[0][0]
        # Not amid a message, which may have begun while there was no stream for large ones.
        if not self._at and self._must_move(len(payload)):
            moved = self._writer.write_moved()
            assert self._pair.large is not None
            self.via = self._pair.large
            return moved
        if self._at or len(payload) > limit:
            return self._next_piece(limit)
        batch: list[Message] = []
        size = 0
        while self._messages and size < limit:
            payload = self._messages[0][0]
            if len(payload) > limit or self._must_move(len(payload)):
                break
            batch.append(self._messages.popleft())
            size += len(payload)
        self.via.unwritten.append((self, batch))
        return self._writer.write_many(batch)

    def _must_move(self, size: int) -> bool:
        """Whether the route has to move to the stream of large messages before one of that size."""
        if size < LARGE or self.via is not self._small:
            return False
        large = self._pair.large
        return large is not None and large is not self._small and not large.over

    def _next_piece(self, limit: int) -> memoryview:
        """Seal the next `limit` bytes of the first message in memory that is used again."""
        payload, stamp, flags = message = self._messages[0]
        content = memoryview(payload)[self._at : self._at + limit]
        self._at += len(content)
        if self._at < len(payload):
            flags |= MORE
        else:
            self._messages.popleft()
            self._at = 0
            self.via.unwritten.append((self, (message,)))
        memory = self._pair.keys.scratch.lend(self._writer.chunk_room(len(content)))
        return self._writer.write_chunk(content, stamp, flags, memory)

    def take_keys(self, keys: DataKeys) -> None:
        super().take_keys(keys)
        self._writer.resume(keys.keys.route_sealer(self._route_id, keys.role))

    def close(self, reason: str) -> None:
        self.leave()
        super().close(reason)

    def uses(self, stream: DataStream) -> bool:
        return stream is self.via or super().uses(stream)

    def suspend(self) -> None:
        super().suspend()
        if not self.via.over:  # the other way's stream was lost
            return
        self._at = 0  # the message that was begun is sent again in full
        if self.route.fates[Lost.STREAM] is Fate.SENDS_AGAIN:
            self._again += len(self.unacknowledged)
            self._messages.extendleft(reversed(self.unacknowledged))
        self.unacknowledged = []
        self.waits_since, self.turned = None, False

    def resume(self) -> None:
        if self.via.over:
            self.via, self.start = self._next_stream(), 0
            resumed = self._writer.write_resumed(self._again)
            self._again = 0
            self.via.resumed += len(resumed)
            self._scheduler.write(self.via, resumed)
            if self.waits:
                self._scheduler.join(self)
        super().resume()

    def received(self, stream: DataStream, kind: int, frames: Sequence[memoryview]) -> bool:
        """Refuse frames: the peer sends nothing on this route."""
        raise ProtocolError(Broken.DATA_AGAINST_ROUTE(route=self._route_id))


class StreamReceiver(_StreamEnd, ReceivingChannel):
    """The receiving end."""

    def __init__(self, pair: StreamPair, route: RouteSink) -> None:
        super().__init__(pair, route)
        self._reader = pair.keys.stream_reader(route.id)
        self._from = self._small

    def counts(self) -> Counts:
        return Counts(newest=None, lost=self._reader.lost)

    def close(self, reason: str) -> None:
        self._reader.close()
        super().close(reason)

    def uses(self, stream: DataStream) -> bool:
        return stream is self._from or super().uses(stream)

    def take_keys(self, keys: DataKeys) -> None:
        super().take_keys(keys)
        self._reader.resume(keys.keys.stream_opener(self._route_id, keys.peer_role))

    def suspend(self) -> None:
        super().suspend()
        if self._from.over:
            self._reader.close()

    def resume(self) -> None:
        if self._from.over:
            self._from = self._next_stream()
        super().resume()

    def received(self, stream: DataStream, kind: int, frames: Sequence[memoryview]) -> bool:
        if stream is not self._from:
            return False  # the last frame on the other stream has not come yet, and order holds across the two
        if kind == DATA:
            if messages := self._reader.open_frames(frames):
                self.route.deliver(messages)
        elif kind == MOVED:
            large = self._pair.large
            # A route moves once, and only where there are two streams.
            if self._from is not self._small or large is None or large is self._small or len(frames) > 1:
                raise ProtocolError(Broken.DATA_AGAINST_ROUTE(route=self._route_id))
            self._reader.open_moved(frames[0])
            self._from = large
            # Lost already, while this frame was on the way: nothing else would have the route resume on the next one.
            self.is_suspended = self.is_suspended or large.over
            large.take_held()
        else:
            for frame in frames:
                self._reader.open_resumed(frame)
        return True


class StreamDuplex(StreamReceiver, StreamSender):
    """Either end of a route that sends both ways. The receiving end's methods come first: what arrives is taken."""


def stream_channel(pair: StreamPair, route: RouteSink) -> StreamSender | StreamReceiver:
    """Return this side's end of a route's channel on streams that are ready."""
    if route.duplex:
        return StreamDuplex(pair, route)
    return StreamSender(pair, route) if route.outgoing else StreamReceiver(pair, route)
