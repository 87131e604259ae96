"""Streams that came in and have not shown yet who they are: bounded in number, in time and in what they cost."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Attach, Established, Failed, Refused
from rsb_bridge.wire.opening import Refusal, RefusalCode

if TYPE_CHECKING:
    import asyncio

    from rsb_bridge.link.server import Server
    from rsb_bridge.wire.connection import Credential, ServerConnection

_MOST = 256
_MOST_OF_ONE_HOST = 64
_HANDSHAKE_WITHIN = 5.0
_FAILURES = 5
_FAILURES_WITHIN = 30.0
_PENALTY = 1.0
_HOSTS_REMEMBERED = 1024
_SAID_EVERY = 10.0
_SAID_MOST = 256
_CODES = {RefusalCode.WRONG_KEY: EventCode.LINK_WRONG_KEY, RefusalCode.UNKNOWN_NAME: EventCode.LINK_UNKNOWN_NAME}


class PendingConnections:
    """All streams that are still strangers, and which hosts have failed lately."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.present: dict[_PendingConnection, None] = {}  # the longest waiting first
        self._failures: dict[str, deque[float]] = {}
        self._said: dict[tuple[str, str], float] = {}

    def arrive(self) -> StreamHandler:
        """The handler of a new stream."""
        return _PendingConnection(self)

    def make_room(self, host: str) -> None:
        """Turn those away that have waited longest, so that those who only wait can't keep others out.

        A host that has too many strangers here loses one of its own.
        """
        of_host = [guest for guest in self.present if guest.host == host]
        if len(of_host) >= _MOST_OF_ONE_HOST:
            of_host[0].reject("too many connections that have not shown who they are")
        elif len(self.present) >= _MOST:
            next(iter(self.present)).reject("too many connections that have not shown who they are")

    def penalty(self, host: str) -> float:
        """How long (s) a host's handshake waits: failures cost time, but lock nobody out (many share an address)."""
        return _PENALTY if len(self._failures.get(host, ())) >= _FAILURES else 0.0

    def failed(self, stream: Stream, code: EventCode, words: str) -> None:
        """A stream was turned away that did not do as a friend would."""
        now = self.server.context.now()
        self._failures.setdefault(stream.host, deque(maxlen=_FAILURES)).append(now)
        if len(self._failures) > _HOSTS_REMEMBERED:
            self._failures.pop(next(iter(self._failures)))
        self.say(stream, code, words)

    def say(self, stream: Stream, code: EventCode, words: str) -> None:
        """Tell the operator of a stream that was turned away; not more often than every 10 s."""
        if (stream.host, words) not in self._said and len(self._said) < _SAID_MOST:
            self._said[stream.host, words] = self.server.context.now()
            self.server.context.log(Level.WARNING, code, f"turned {stream.peer} away: {words}")

    def tick(self) -> None:
        """Once a second: forget old failures, and what was said of them."""
        now = self.server.context.now()
        for host, times in tuple(self._failures.items()):
            while times and now - times[0] > _FAILURES_WITHIN:
                times.popleft()
            if not times:
                del self._failures[host]
        self._said = {key: time for key, time in self._said.items() if now - time < _SAID_EVERY}

    def close(self) -> None:
        """Turn all away."""
        for guest in tuple(self.present):
            guest.reject("the server stops")


class _PendingConnection(StreamHandler):
    """One stream until it is a link's control connection, a route's stream, or gone."""

    def __init__(self, guests: PendingConnections) -> None:
        self.host = ""
        self._pending = guests
        self._server = guests.server
        self._connection: ServerConnection = guests.server.connection(self._identify)
        self._stream: Stream | None = None
        self._name = ""
        self._deadline: asyncio.TimerHandle | None = None
        self._held_back = bytearray()
        self._penalty: asyncio.TimerHandle | None = None

    def connected(self, stream: Stream) -> None:
        self._pending.make_room(stream.host)
        self._stream, self.host = stream, stream.host
        self._pending.present[self] = None
        loop = self._server.context.loop
        self._deadline = loop.call_later(_HANDSHAKE_WITHIN, self.reject, "no handshake within 5 s")
        if penalty := self._pending.penalty(self.host):
            self._penalty = loop.call_later(penalty, self._serve_penalty)

    def received(self, data: bytes) -> None:
        if self._penalty is None:
            self._take(data)
        elif len(self._held_back) + len(data) > 8192:
            self.reject("too much before the handshake")
        else:
            self._held_back += data

    def closed(self, reason: str) -> None:
        self._leave()

    def reject(self, words: str) -> None:
        """Say no and close."""
        stream = self._stream
        if stream is None:
            return
        self._leave()
        self._pending.failed(stream, EventCode.LINK_REJECTED, words)
        stream.write(self._connection.refuse(RefusalCode.BUSY, words))
        stream.close(words)

    def _identify(self, name: str) -> Credential:
        self._name = name
        return self._server.credential(name)

    def _serve_penalty(self) -> None:
        self._penalty = None
        data, self._held_back = bytes(self._held_back), bytearray()
        if data:
            self._take(data)

    def _take(self, data: bytes) -> None:
        stream, connection = self._stream, self._connection
        if stream is None:
            return
        events = connection.receive_data(data)
        stream.write(connection.data_to_send())
        for index, event in enumerate(events):
            match event:
                case Established():
                    self._leave()
                    control = self._server.established(stream, connection, event)
                    control.take(events[index + 1 :])
                    return
                case Attach():
                    self._leave()
                    self._attach(stream, event)
                    return
                case Refused(code, words, _):
                    self._refused(stream, _CODES.get(code, EventCode.LINK_REJECTED), self._for_operator(code, words))
                case Failed(reason):
                    self._refused(stream, EventCode.LINK_REJECTED, reason)
                case _:
                    pass

    def _attach(self, stream: Stream, event: Attach) -> None:
        try:
            self._server.attach(stream, self._connection, event)
        except Refusal as refusal:  # costs its host nothing: a friend's route may have been closed meanwhile
            self._pending.say(stream, EventCode.LINK_REJECTED, refusal.words)
            stream.write(self._connection.refuse(refusal.code, refusal.words))
            stream.close(refusal.words)

    def _refused(self, stream: Stream, code: EventCode, words: str) -> None:
        self._leave()
        self._pending.failed(stream, code, words)
        stream.close(words)

    def _for_operator(self, code: RefusalCode, words: str) -> str:
        if code is RefusalCode.WRONG_KEY:
            fingerprint = self._server.fingerprint_of(self._name)
            return f"{words}; this side's key has the fingerprint {fingerprint}: compare it with the client's"
        if code is RefusalCode.UNKNOWN_NAME:
            return f"{words}: {self._server.remedy_for_unknown()}"
        return words

    def _leave(self) -> None:
        self._pending.present.pop(self, None)
        for timer in (self._deadline, self._penalty):
            if timer is not None:
                timer.cancel()
        self._deadline = self._penalty = self._stream = None
