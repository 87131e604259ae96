"""Unauthenticated inbound connections, limited in number, in time and in what they cost."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Attach, Established, Event, Failed, Refused
from rsb_bridge.wire.preamble import Refusal, RefusalCode

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.wire.connection import Credential, ServerConnection

_MOST = 256
_MOST_OF_ONE_HOST = 64
"""The streams that linked clients have yet to open are allowed on top of both limits."""
_HANDSHAKE_WITHIN = 5.0
_FAILURES = 5
_FAILURES_WITHIN = 30.0
_PENALTY = 1.0
_HOSTS_REMEMBERED = 1024
_LOGGED_AFTER, _LOGGED_AFTER_AT_LAST = 60.0, 3600.0
"""s until the same refusal of the same host is logged again; twice as long each time."""
_FORGOTTEN_AFTER = 60.0
"""s without another one; a client that is refused tries again within 12 s."""
_MOST_LOGGED = 256
_CODES = {
    RefusalCode.WRONG_KEY: EventCode.LINK_WRONG_KEY,
    RefusalCode.UNKNOWN_NAME: EventCode.LINK_UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: EventCode.LINK_NAME_TAKEN,
}
_TOO_MANY = "too many unauthenticated connections"


class _Logged:
    """A refusal that is in the log already.

    Attributes:
        tried_at: s, when it last happened.
    """

    def __init__(self, now: float) -> None:
        self.tried_at = now
        self._wait = _LOGGED_AFTER
        self._due = now + self._wait

    def due_again(self, now: float) -> bool:
        """It happens again, at `now` (s): whether to log it."""
        self.tried_at = now
        if now < self._due:
            return False
        self._wait = min(2 * self._wait, _LOGGED_AFTER_AT_LAST)
        self._due = now + self._wait
        return True


class Admission(Protocol):
    """Who decides whether a connection is let in: the server."""

    def connection(self, identify: Callable[[str], Credential]) -> ServerConnection:
        """The state machine of an inbound stream."""
        ...

    def credential(self, name: str) -> Credential:
        """What a client of that name has to prove.

        Raises:
            Refusal: there is no such client.
        """
        ...

    def established(self, stream: Stream, connection: ServerConnection, event: Established) -> ControlChannel:
        """A client has authenticated: make its link.

        Raises:
            Refusal: another machine has its name.
        """
        ...

    def attach(self, stream: Stream, connection: ServerConnection, event: Attach) -> None:
        """A stream was opened for a route: give it to the route.

        Raises:
            Refusal: no route waits for it.
        """
        ...

    def streams_awaited(self, host: str = "") -> int:
        """How many streams linked clients have yet to open; with `host`: those at that host."""
        ...

    def refused(self, name: str, stream: Stream, code: RefusalCode, message: str) -> None:
        """A client was refused that calls itself by that name, which may be empty, and may be another's."""
        ...

    def remedy_for_unknown(self) -> str:
        """What an operator does about a client whose name the session file does not have."""
        ...


class PendingConnections:
    """All inbound streams that have not authenticated yet, and the hosts that failed to lately."""

    def __init__(self, context: Context, admission: Admission) -> None:
        self.context = context
        self.admission = admission
        self._present: dict[_PendingConnection, None] = {}  # the longest waiting first
        self._of_host: Counter[str] = Counter()
        self._failures: dict[str, deque[float]] = {}
        self._logged: dict[tuple[str, str], _Logged] = {}

    def arrive(self) -> StreamHandler:
        """The handler of a new stream."""
        return _PendingConnection(self)

    def add(self, pending: _PendingConnection) -> None:
        """Count a new connection; if there are too many, reject the one that has waited longest.

        A host that has too many loses one of its own, so that connections that only wait cannot keep others out.
        """
        if self._full(self._of_host[pending.host], _MOST_OF_ONE_HOST, pending.host):
            next(each for each in self._present if each.host == pending.host).reject(_TOO_MANY)
        elif self._full(len(self._present), _MOST):
            next(iter(self._present)).reject(_TOO_MANY)
        self._present[pending] = None
        self._of_host[pending.host] += 1

    def _full(self, count: int, limit: int, host: str = "") -> bool:
        return count >= limit and count >= limit + self.admission.streams_awaited(host)

    def remove(self, pending: _PendingConnection) -> None:
        """A connection has authenticated or is gone."""
        if pending in self._present:
            del self._present[pending]
            self._of_host[pending.host] -= 1
            if not self._of_host[pending.host]:
                del self._of_host[pending.host]

    def expel(self, name: str, message: str) -> None:
        """Reject those who have begun to authenticate as this client: what they prove counts no more."""
        for pending in tuple(self._present):
            if pending.name == name:
                pending.reject(message)

    def penalty(self, host: str) -> float:
        """The delay (s) of a host's handshake: failures cost time, but lock nobody out (many share an address)."""
        return _PENALTY if len(self._failures.get(host, ())) >= _FAILURES else 0.0

    def failed(self, stream: Stream, code: EventCode, message: str, name: str = "") -> None:
        """Record a failed authentication of a client that calls itself by that name."""
        now = self.context.now()
        self._failures.setdefault(stream.host, deque(maxlen=_FAILURES)).append(now)
        if len(self._failures) > _HOSTS_REMEMBERED:
            self._failures.pop(next(iter(self._failures)))
        self.log_rejection(stream, code, message, name)

    def log_rejection(self, stream: Stream, code: EventCode, message: str, name: str = "") -> None:
        """Log that a stream was rejected, ever more rarely for each host and message.

        It takes nothing of the link's quota: whoever calls itself so need not be that client.
        """
        if self._is_new(stream.host, message):
            self.context.events.add(Level.WARNING, code, f"rejected {stream.peer}: {message}", link=name)

    def _is_new(self, host: str, message: str) -> bool:
        now, logged = self.context.now(), self._logged.get((host, message))
        if logged is not None:
            return logged.due_again(now)
        if len(self._logged) >= _MOST_LOGGED:
            return False
        self._logged[host, message] = _Logged(now)
        return True

    def shortage(self, message: str) -> None:
        """No connection can be accepted for now: tell the operator, and reject the one that has waited longest."""
        if self._is_new("", message):
            text = f"new connections have to wait: {message}"
            self.context.log(Level.ERROR, EventCode.ENGINE_SHORTAGE, text)
        for oldest in tuple(self._present)[:1]:
            oldest.reject("the server has no file descriptors left")

    def tick(self) -> None:
        """Once a second: forget old failures, and which were logged."""
        now = self.context.now()
        for host, times in tuple(self._failures.items()):
            while times and now - times[0] > _FAILURES_WITHIN:
                times.popleft()
            if not times:
                del self._failures[host]
        self._logged = {key: each for key, each in self._logged.items() if now - each.tried_at < _FORGOTTEN_AFTER}

    def close(self) -> None:
        """Reject all."""
        for pending in tuple(self._present):
            pending.reject("the server stops")


class _PendingConnection(StreamHandler):
    """One stream until it is a link's control connection, a route's stream, or gone."""

    def __init__(self, pending: PendingConnections) -> None:
        self.host = ""
        self._pending = pending
        self._admission = pending.admission
        self._connection: ServerConnection = pending.admission.connection(self._identify)
        self._stream: Stream | None = None
        self.name = ""
        self._deadline: asyncio.TimerHandle | None = None
        self._held_back = bytearray()
        self._penalty: asyncio.TimerHandle | None = None

    def connected(self, stream: Stream) -> None:
        self._stream, self.host = stream, stream.host
        self._pending.add(self)
        loop = self._pending.context.loop
        self._deadline = loop.call_later(_HANDSHAKE_WITHIN, self.reject, "no handshake within 5 s")
        if penalty := self._pending.penalty(self.host):
            self._penalty = loop.call_later(penalty, self._serve_penalty)

    def received(self, data: bytes) -> None:
        if self._penalty is None:
            self._take(data)
        elif len(self._held_back) + len(data) > 8192:
            self.reject("too much data before the handshake")
        else:
            self._held_back += data

    def closed(self, reason: str) -> None:
        self._leave()

    def reject(self, message: str) -> None:
        """Refuse the stream and close it."""
        stream = self._stream
        if stream is None:
            return
        self._leave()
        self._pending.failed(stream, EventCode.LINK_REJECTED, message)
        stream.write(self._connection.refuse(RefusalCode.BUSY, message))
        stream.close(message)

    def _identify(self, name: str) -> Credential:
        credential = self._admission.credential(name)
        self.name = name
        return credential

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
                    self._established(stream, event, events[index + 1 :])
                    return
                case Attach():
                    self._leave()
                    self._attach(stream, event)
                    return
                case Refused(code, message):
                    message = self._for_operator(code, message)
                    self._admission.refused(self.name, stream, code, message)
                    self._refused(stream, _CODES.get(code, EventCode.LINK_REJECTED), message)
                case Failed(reason):
                    self._refused(stream, EventCode.LINK_REJECTED, reason)
                case _:
                    pass

    def _established(self, stream: Stream, event: Established, more: list[Event]) -> None:
        try:
            control = self._admission.established(stream, self._connection, event)
        except Refusal as refusal:
            self._admission.refused(self.name, stream, refusal.code, refusal.message)
            self._pending.log_rejection(stream, _CODES[refusal.code], refusal.message, self.name)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            stream.close(refusal.message)
        else:
            control.take(more)

    def _attach(self, stream: Stream, event: Attach) -> None:
        try:
            self._admission.attach(stream, self._connection, event)
        except Refusal as refusal:  # no failure of its host: the route may have been closed meanwhile
            self._pending.log_rejection(stream, EventCode.LINK_REJECTED, refusal.message)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            stream.close(refusal.message)

    def _refused(self, stream: Stream, code: EventCode, message: str) -> None:
        self._leave()
        self._pending.failed(stream, code, message, self.name)
        stream.close(message)

    def _for_operator(self, code: RefusalCode, message: str) -> str:
        if code is RefusalCode.WRONG_KEY:
            return f"{message}: copy one side's key file to the other"
        if code is RefusalCode.UNKNOWN_NAME:
            return f"{message}: {self._admission.remedy_for_unknown()}"
        return message

    def _leave(self) -> None:
        self._pending.remove(self)
        for timer in (self._deadline, self._penalty):
            if timer is not None:
                timer.cancel()
        self._deadline = self._penalty = self._stream = None
