"""Unauthenticated inbound connections, limited in number, in time and in what they cost."""

from __future__ import annotations

from enum import IntEnum, auto
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.link.refused_clients import CAUSES, Refusals, network
from rsb_bridge.model.budgets import CONNECTION
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Attach, Established, Event, Failed, RefusalCode, Refused
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.preamble import Refusal

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable

    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.model.budgets import Strangers
    from rsb_bridge.wire.connection import ServerConnection

_MOST = 256
_MOST_OF_ONE_HOST = 64
"""The streams that linked clients have yet to open are allowed on top of both limits."""
_MOST_OF_RESERVE = descriptors.RESERVE // 4
_MOST_ACCEPTED = 4
"""Of one client; it has one, unless somebody plays its first messages again."""
_HANDSHAKE_WITHIN = 5.0
_CODES = {
    RefusalCode.WRONG_KEY: EventCode.LINK_WRONG_KEY,
    RefusalCode.UNKNOWN_NAME: EventCode.LINK_UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: EventCode.LINK_NAME_TAKEN,
    RefusalCode.SHUT_DOWN: EventCode.LINK_SHUT_DOWN,
}
_ONLY_BRIDGES = "correct the address in that program, as only bridges use this port"
_SENDS_NOTHING = "it sent nothing for 5 s: probably a port scan or a health check, as a bridge sends its name"


class Rejected(Wording):
    """Reasons why a connection is closed before it has authenticated."""

    TOO_MANY = "too many unauthenticated connections"
    NO_HANDSHAKE = "no handshake within {seconds:g} s"
    SUPERSEDED = "others came after it as the same client"
    SERVER_STOPS = "the server stops"


class _Stage(IntEnum):
    """How far a connection has come: where there are too many, those of the lowest stage go first."""

    REFUSED = auto()  # and not told so yet
    WAITING = auto()  # silent, or in the middle of its first message, which proves nothing: half of one costs nothing
    ACCEPTED = auto()  # its first message opens under the client's key


class Admission(Protocol):
    """Who decides whether a connection is let in: the server."""

    def connection(self) -> ServerConnection:
        """The state machine of an inbound stream."""
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

    def refused(self, name: str, stream: Stream, code: RefusalCode, message: str) -> str:
        """A client was refused that calls itself by that name, which may be empty, and may be another's.

        Returns:
            The name of the link that shows it; empty: none does.
        """
        ...

    def refused_proven(self, stream: Stream, code: RefusalCode, peer: Hello) -> None:
        """A client was refused that has proven its key: another one has its name, or its link is shut down."""
        ...

    def remedy_for_unknown(self, name: str) -> str:
        """Return the remedy for a client whose name is not in the session file."""
        ...


class PendingConnections:
    """All inbound streams that have not authenticated yet.

    Attributes:
        refusals: what was refused lately.
    """

    def __init__(self, context: Context, admission: Admission) -> None:
        self.context = context
        self.admission = admission
        self.refusals = Refusals(context)
        self.strangers: Strangers = context.transports.strangers
        self._turned_away = 0
        self._present: dict[_PendingConnection, None] = {}  # the longest waiting first

    def arrive(self) -> StreamHandler:
        """The handler of a new stream."""
        return _PendingConnection(self)

    def add(self, pending: _PendingConnection) -> bool:
        """Count a new connection. If there are too many, reject the one of the lowest stage that has waited longest.

        A host that has too many loses one of its own, so that connections that only wait cannot keep others out.

        Returns:
            False if the strangers' budget is spent and none of it by connections of links.
        """
        of_host = [each for each in self._present if each.network == pending.network]
        if self._full(len(of_host), _MOST_OF_ONE_HOST, pending.host):
            self._reject_lowest(of_host, Rejected.TOO_MANY())
        elif self._full(len(self._present), _MOST) or self._uses_reserve():
            self._reject_lowest(self._present, Rejected.TOO_MANY())
        while not self.strangers.take(CONNECTION):
            if not self._present:
                return False
            self._reject_lowest(self._present, Rejected.TOO_MANY())
        self._present[pending] = None
        return True

    def _full(self, count: int, limit: int, host: str = "") -> bool:
        return count >= limit and count >= limit + self.admission.streams_awaited(host)

    def _uses_reserve(self) -> bool:
        """Whether connections that only wait would take what is kept for those that must not fail."""
        return len(self._present) >= _MOST_OF_RESERVE and descriptors.scarce()

    def _reject_lowest(self, among: Iterable[_PendingConnection], message: str) -> None:
        min(among, key=lambda each: each.stage).reject(message)

    def accepted(self, pending: _PendingConnection) -> None:
        """A connection's first message opens under its client's key."""
        same = [each for each in self._present if each.name == pending.name and each.stage is _Stage.ACCEPTED]
        for oldest in same[:-_MOST_ACCEPTED]:
            oldest.reject(Rejected.SUPERSEDED())

    def remove(self, pending: _PendingConnection) -> None:
        """A connection has authenticated or is gone."""
        self._present.pop(pending, None)

    def expel(self, name: str, message: str) -> None:
        """Reject those who have begun to authenticate as this client: what they prove counts no more."""
        for pending in tuple(self._present):
            if pending.name == name:
                pending.reject(message)

    def shortage(self, message: str) -> None:
        """No connection can be accepted for now: tell the operator, and reject the pending one of the lowest stage."""
        if self.refusals.is_new("", message):
            text = f"new connections have to wait: {message}"
            self.context.log(Level.ERROR, EventCode.ENGINE_SHORTAGE, text)
        if self._present:
            self._reject_lowest(self._present, "the server has no file descriptors left")

    def tick(self) -> None:
        """Once a second: forget old refusals, and tell the operator what strangers were refused for lack of room."""
        self.refusals.tick()
        turned_away = self.strangers.turned_away
        if turned_away > self._turned_away and self.refusals.is_new("", EventCode.LINK_STRANGERS):
            self._turned_away = turned_away
            text = f"{turned_away:,} connections or samples of strangers dropped: block the flood with a firewall"
            self.context.log(Level.WARNING, EventCode.LINK_STRANGERS, text)

    def close(self) -> None:
        """Reject all."""
        for pending in tuple(self._present):
            pending.reject(Rejected.SERVER_STOPS())


class _PendingConnection(StreamHandler):
    """One stream until it is a link's control connection, a route's stream, or gone."""

    def __init__(self, pending: PendingConnections) -> None:
        self.stage = _Stage.WAITING
        self.host = self.network = self.name = ""
        self._pending = pending
        self._admission = pending.admission
        self._connection: ServerConnection = pending.admission.connection()
        self._stream: Stream | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._refusal: tuple[bytes, str] = (b"", "")
        self._counted = False

    def connected(self, stream: Stream) -> None:
        self._stream, self.host, self.network = stream, stream.host, network(stream.host)
        self._counted = self._pending.add(self)
        if not self._counted:
            self.reject(Rejected.TOO_MANY())
            return
        loop = self._pending.context.loop
        self._deadline = loop.call_later(_HANDSHAKE_WITHIN, self._gives_up)

    def closed(self, reason: str) -> None:
        self._leave()

    def _give_share_back(self) -> None:
        """Give the share of the budget back: the peer has proven its key, or the connection is being closed."""
        if self._counted:
            self._counted = False
            self._pending.strangers.give(CONNECTION)

    def _gives_up(self) -> None:
        """Reject a client whose handshake takes too long."""
        if self._stream is None or self._stream.received_bytes:
            self.reject(Rejected.NO_HANDSHAKE(seconds=_HANDSHAKE_WITHIN))
        else:
            self.reject(_SENDS_NOTHING, LinkCause.NO_ANSWER)

    def reject(self, message: str, cause: str = "") -> None:
        """Refuse the stream and close it."""
        stream = self._stream
        if stream is None:
            return
        if self.stage is _Stage.REFUSED:
            self._tell()
            return
        self._leave()
        self._pending.refusals.log(stream, EventCode.LINK_REJECTED, message, cause=cause)
        stream.write(self._connection.refuse(RefusalCode.BUSY, message))
        stream.close(message)

    def received(self, data: bytes) -> None:
        stream, connection = self._stream, self._connection
        if stream is None or self.stage is _Stage.REFUSED:
            return
        events = connection.receive_data(data)
        self.name = connection.name
        answer = connection.data_to_send()
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
                case Refused(code, message, None):
                    message = self._for_operator(code, message)
                    self.name = self._admission.refused(self.name, stream, code, message)
                    cause = CAUSES.get(code, LinkCause.REFUSED)
                    self._refuse(stream, _CODES.get(code, EventCode.LINK_REJECTED), message, answer, cause)
                    return
                case Refused(code, message, Hello() as peer):
                    self._leave()
                    self._refuse_proven(stream, Refusal(code, message), peer)
                    return
                case Failed(reason, foreign):
                    if foreign is None:
                        self._refuse(stream, EventCode.LINK_REJECTED, reason, answer)
                    else:
                        text = f"{reason}: {_ONLY_BRIDGES}"
                        self._refuse(stream, EventCode.LINK_REJECTED, text, answer, LinkCause.NOT_A_BRIDGE)
                    return
                case _:
                    pass
        stream.write(answer)
        if connection.accepted and self.stage < _Stage.ACCEPTED:
            stream.authenticate(connection.sample_secret, opener=False)
            self.stage = _Stage.ACCEPTED
            self._pending.accepted(self)

    def _established(self, stream: Stream, event: Established, more: list[Event]) -> None:
        try:
            control = self._admission.established(stream, self._connection, event)
        except Refusal as refusal:
            assert isinstance(event.peer, Hello)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            self._refuse_proven(stream, refusal, event.peer)
        else:
            stream.trust()
            control.take(more)

    def _refuse_proven(self, stream: Stream, refusal: Refusal, peer: Hello) -> None:
        """Refuse a client that has the key: that is no failed authentication."""
        self._admission.refused_proven(stream, refusal.code, peer)
        self._pending.refusals.log(stream, _CODES[refusal.code], refusal.message, self.name)
        stream.close(refusal.message)

    def _attach(self, stream: Stream, event: Attach) -> None:
        try:
            self._admission.attach(stream, self._connection, event)
            stream.trust()
        except Refusal as refusal:  # no failure of its host: the route may have been closed meanwhile
            self._pending.refusals.log(stream, EventCode.LINK_REJECTED, refusal.message)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            stream.close(refusal.message)

    def _refuse(self, stream: Stream, code: EventCode, message: str, answer: bytes, cause: str = "") -> None:
        """Somebody failed to authenticate: say so, later to a host where many have failed."""
        refusals = self._pending.refusals
        refusals.failed(self.host)
        refusals.log(stream, code, message, self.name, cause)
        self.stage, self._refusal = _Stage.REFUSED, (answer, message)
        if delay := refusals.delay(self.host):
            self._stop_waiting()
            self._deadline = self._pending.context.loop.call_later(delay, self._tell)
            stream.pause_reading()
        else:
            self._tell()

    def _tell(self) -> None:
        stream, (answer, message) = self._stream, self._refusal
        assert stream is not None, "who has left has no timer"
        self._leave()
        stream.write(answer)
        stream.close(message)

    def _for_operator(self, code: RefusalCode, message: str) -> str:
        if code is RefusalCode.WRONG_KEY:
            return f"{message}: copy one side's key file to the other"
        if code is RefusalCode.UNKNOWN_NAME:
            return f"{message}: {self._admission.remedy_for_unknown(self.name)}"
        return message

    def _leave(self) -> None:
        self._pending.remove(self)
        self._stop_waiting()
        self._give_share_back()
        self._stream = None

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
