"""An authenticated control connection."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import msgspec

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.tasks import NOT_TOO_EARLY, SLICE, turn_began
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.codec import decode, encode, invalid
from rsb_bridge.wire.events import DataFrame, Event, Failed, MessageReceived, StreamRefused
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import Describe, Shutdown
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

    from rsb_bridge.channel.data_stream import DataStream
    from rsb_bridge.model.reason import Reason
    from rsb_bridge.wire.connection import ClientConnection, ServerConnection
    from rsb_bridge.wire.messages import ControlMessageBase, UrgentMessage

_E = TypeVar("_E")

Slices: TypeAlias = "Generator[int, None, int]"
"""Work in slices: yields how many entries a slice had, and returns how many the last one had."""

# Of one slice, at most. It takes about 1 ms: an entry of a report 20 to 30 microseconds to decode and judge, 2 KiB of
# short texts 1 ms to decode.
ENTRIES, BYTES = 32, 2 << 10

# Units of work that are done before the I/O loop does other work, each up to 0.5 ms. An event is one, as it may create
# a DDS endpoint; further ones are each further endpoint, each `_BYTES_A_UNIT` and each `_ENTRIES_A_UNIT` of it. Nothing
# more is done after a whole slice, nor once the turn has taken `tasks.SLICE`.
_AT_ONCE, _BYTES_A_UNIT, _ENTRIES_A_UNIT = 8, 1 << 10, 8

# What a peer may have this side do: at once, and then in a second, for ever.
_MESSAGES, _MESSAGES_A_SECOND = 4096, 500.0  # a thousand routes take as many when they are opened
_BYTES, _BYTES_A_SECOND = 4 * CONTROL_LIMIT, CONTROL_LIMIT  # 0.5 s of CPU time at most
# Entries of reports and lists. A thousand routes report once a second, and up to ten times as often at high rates; a
# steady flood takes a fifth of the thread's time.
_ENTRIES, _ENTRIES_A_SECOND = 40_000, 10_000.0

_MOST_WAITING = 8 * CONTROL_LIMIT  # unsent bytes: a thousand routes' reports are a fifth of one frame


def entries_in_slices(entries: Iterable[tuple[_E, int]], work: Callable[[_E], None]) -> Slices:
    """Process a long list of the peer in slices, between which other links have their turn.

    Args:
        entries: the entries, each with its bytes.

    Raises:
        ProtocolError: an entry is invalid.
    """
    count = size = 0
    try:
        for entry, length in entries:
            if count >= ENTRIES or size >= BYTES:
                yield count
                count = size = 0
            work(entry)
            count += 1
            size += length
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise invalid(error) from None
    return count


class _Unfinished(NamedTuple):
    """The rest of a message's work."""

    message_type: type[ControlMessageBase]
    slices: Slices


_NO_GOODBYE = (
    "the other side closed the connection without a goodbye: check whether its process or machine has died, "
    "or hears nothing from this side"
)


class ControlChannel(StreamHandler):
    """The stream's handler once the handshake is done.

    Args:
        handlers: handlers of control messages, by type. Each may return work to be done in slices before the next
            message.
        lost: is called once with reason and code when the connection is over. No message comes after it.
        handled: is called with the type of each message that has been handled to its end.

    Attributes:
        data: the same stream as a data stream, or None if data has streams of its own.
        is_fault: whether the peer broke the protocol on it, or this side failed: then nothing of it goes on.
    """

    def __init__(
        self,
        stream: Stream,
        connection: ClientConnection | ServerConnection,
        handlers: Mapping[type, Callable[[Any], Slices | None]],
        lost: Callable[[str, EventCode], None],
        handled: Callable[[type[ControlMessageBase]], None],
    ) -> None:
        self.stream = stream
        self.is_fault = False
        self.data: DataStream | None = None
        self.over = False
        self._handlers = handlers
        self._lost = lost
        self._handled = handled
        self._connection = connection
        self._events: deque[Event] = deque()
        self._unsent = bytearray()  # sealed; to measure the stream's own buffer for each message would cost more
        self._loop = asyncio.get_running_loop()
        now = self._loop.time()
        self._allowance = TokenBucket(_MESSAGES, _MESSAGES_A_SECOND, now)
        self._volume = TokenBucket(_BYTES, _BYTES_A_SECOND, now)
        self._entries = TokenBucket(_ENTRIES, _ENTRIES_A_SECOND, now)
        self._work: _Unfinished | None = None  # of the newest message
        self._owes = False  # more came than the volume allows
        stream.handler = self

    def send(self, message: ControlMessageBase) -> None:
        """Send a message, or keep it until the stream takes it."""
        self.send_encoded(encode(message))

    def send_encoded(self, content: bytes) -> None:
        """Send a message as it was encoded; see `send`."""
        sealed = self._connection.send_encoded(content)
        if not self.stream.congested:
            self.stream.write(sealed)
        elif len(self._unsent) + len(sealed) > _MOST_WAITING:
            self.stream.abort("the peer is not reading: control send buffer full")  # `closed` comes later
        else:
            self._unsent += sealed

    def _flush(self) -> None:
        if self._unsent:
            self.stream.write(bytes(self._unsent))
            self._unsent.clear()

    def shut_down(self, reason: str, *, retry_after: float | None, code: EventCode = EventCode.LINK_CLOSED) -> None:
        """Tell the peer that this ends on purpose, and end it."""
        self.send(Shutdown(reason=sanitize_text(reason), retry_after=retry_after))
        self._flush()  # `close` sends what waits in the stream, and knows nothing of what waits here
        self.stream.close(reason)
        self._end(reason, code)

    def abort(self, reason: str, code: EventCode = EventCode.LINK_LOST) -> None:
        """End it without telling the peer."""
        self.stream.abort(reason)
        self._end(reason, code)

    def leave(self, reason: str) -> None:
        """End it without telling anybody: the association has another connection."""
        self.over = True
        self.stream.abort(reason)

    def received(self, data: bytes) -> None:
        self.receive(self._connection.receive_data(data))
        if self.data is None:  # else most of them may be messages, which a radio keeps slow enough
            self._charge(len(data))

    def _charge(self, size: int) -> None:
        """Read no more until so many bytes are within the volume allowed."""
        now = self._loop.time()
        owed, self._owes = self._owes, not self._volume.take(size, now)
        if self._owes:
            self.stream.pause_reading()
            self._loop.call_later((size - self._volume.left(now)) / _BYTES_A_SECOND + NOT_TOO_EARLY, self._charge, size)
        elif owed:
            self._resume()

    def receive(self, events: list[Event]) -> None:
        """Handle events, a few at a time; reading pauses until all are handled."""
        if self.over:  # the link has not taken the connection, with whose last handshake message these came
            return
        waits = self._waits
        self._events.extend(events)
        if not waits:  # else `_go_on` is due, and these come after the earlier ones
            self._act()

    def take_urgent(self, message: UrgentMessage) -> None:
        """Handle a message that came as a datagram, unless more come than the peer may send: it comes here, too."""
        if self._allowance.take(1, self._loop.time()):
            self._handlers[type(message)](message)

    @property
    def _waits(self) -> bool:
        return bool(self._events) or self._work is not None

    def _act(self) -> None:
        units, delay, began = _AT_ONCE, 0.0, turn_began(self._loop)
        while units > 0 and self._waits:
            now = self._loop.time()
            if units < _AT_ONCE and now - began >= SLICE:
                break
            if (owed := -self._entries.left(now)) > 0:
                delay = owed / _ENTRIES_A_SECOND + NOT_TOO_EARLY
                break
            if self._work is not None:
                units -= 1 + self._do_slice(self._work, now) // _ENTRIES_A_UNIT
                if self._work is not None:
                    units = 0  # it was a whole slice
            elif isinstance(self._events[0], MessageReceived) and not self._allowance.take(1, now):
                delay = (1 - self._allowance.left(now)) / _MESSAGES_A_SECOND
                break
            else:
                units -= self._act_on(self._events.popleft())
            if self.over:  # the event ended it
                self._events.clear()
                self._work = None
                return
        if self._waits:
            self.stream.pause_reading()
            self._loop.call_later(max(0.0, delay), self._go_on)  # even at once: other links have their turn before

    def _do_slice(self, work: _Unfinished, now: float) -> int:
        """Do one slice of a message's work; return how many entries that had."""
        try:
            entries = next(work.slices)
        except StopIteration as end:
            self._work = None
            self._handled(work.message_type)
            entries = int(end.value)
        except ProtocolError as error:
            self._work = None
            self.broken(error)
            return 0
        self._entries.spend(entries, now)
        return entries

    def _go_on(self) -> None:
        if not self.over:
            self.stream.received_at = self._loop.time()  # a peer that is not read for now is not silent
            self._act()
            self._resume()

    def _resume(self) -> None:
        if not self.over and not self._waits and not self._owes:
            self.stream.resume_reading()

    def _act_on(self, event: Event) -> int:
        """Act on an event; return the units of work that it was."""
        match event:
            case MessageReceived(content):
                try:
                    message = decode(content)
                except ProtocolError as error:
                    self.broken(error)
                    return 1
                message_type = type(message)
                if (slices := self._handlers[message_type](message)) is None:
                    self._handled(message_type)
                else:
                    self._work = _Unfinished(message_type, slices)
                endpoints = len(message.sources) if isinstance(message, Describe) else 1
                return endpoints + len(content) // _BYTES_A_UNIT
            case DataFrame(frame):
                assert self.data is not None  # they come on multiplexed connections only
                try:
                    self.data.received_frame(frame)
                except (ProtocolError, SealError) as error:
                    self.broken(error)
            case Failed(reason):
                self.broken(reason)
            case StreamRefused(_, reason):
                self.abort(reason)
        return 1

    def broken(self, reason: object) -> None:
        self.is_fault = True
        self.abort(f"the peer broke the format: {reason}")

    def writable(self) -> None:
        self._flush()
        if self.data is not None:
            self.data.writable()

    def closed(self, reason: Reason) -> None:
        # A killed process ends its streams in order, too.
        self._end(_NO_GOODBYE if reason.code is EndCode.LEFT else reason.text, EventCode.LINK_LOST)

    def _end(self, reason: str, code: EventCode) -> None:
        if not self.over:  # the end of the stream follows each end that begins here
            self.over = True
            self._lost(reason, code)
