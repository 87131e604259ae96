"""Streams that come to a server, until each is a link's control connection, a data stream, or refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.link.pending_connections import ConnectionStage, Limits, PendingConnection, PendingConnections, Rejected
from rsb_bridge.link.refused_clients import CAUSES
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport import descriptors
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.wire.events import Attach, Established, Event, Failed, RefusalCode, StreamRefused
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.preamble import Refusal

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.wire.connection import ServerConnection

_LIMITS = Limits(total=256, of_one_host=64, accepted=4, when_scarce=descriptors.RESERVE // 4)
"""The streams that linked clients have yet to open are allowed on top of the first two.

Round figures: 256 connections take a quarter of what all strangers may have (`model.budgets`). With them, a robot links
through floods of 20,000 connections a second (bench/README)."""
_CODES = {
    RefusalCode.WRONG_KEY: EventCode.LINK_WRONG_KEY,
    RefusalCode.UNKNOWN_NAME: EventCode.LINK_UNKNOWN_NAME,
    RefusalCode.NAME_TAKEN: EventCode.LINK_NAME_TAKEN,
    RefusalCode.SHUT_DOWN: EventCode.LINK_SHUT_DOWN,
}
_ONLY_BRIDGES = "correct the address in that program, as only bridges use this port"


class Admission(Protocol):
    """The server, which accepts or refuses clients."""

    def connection(self) -> ServerConnection:
        """Return the state machine of an inbound stream."""
        ...

    def established(self, stream: Stream, connection: ServerConnection, event: Established) -> ControlChannel:
        """Make the link of a client that has authenticated.

        Raises:
            Refusal: another machine has its name.
        """
        ...

    def attach(self, stream: Stream, connection: ServerConnection, event: Attach) -> None:
        """Give a stream to the route that it was opened for.

        Raises:
            Refusal: no route needs it.
        """
        ...

    def streams_awaited(self, host: str = "") -> int:
        """Return the number of streams that linked clients have yet to open; with `host`, only clients at that host."""
        ...

    def refused(self, name: str, stream: Stream, code: RefusalCode, message: str) -> str:
        """Record the refusal of a client.

        Returns:
            The name of the link that shows it, or an empty string.
        """
        ...

    def refused_proven(self, stream: Stream, code: RefusalCode, peer: Hello) -> None:
        """Record the refusal of a client that has proven its key: its name is taken, or its link is shut down."""
        ...

    def remedy_for_unknown(self, name: str) -> str:
        """Return the remedy for a client whose name is not in the session file."""
        ...


class InboundStreams(PendingConnections):
    """The streams of clients that have not authenticated yet."""

    def __init__(self, context: Context, admission: Admission) -> None:
        super().__init__(context, context.transports.strangers, _LIMITS, admission.streams_awaited)
        self.admission = admission
        self._context = context
        self._turned_away = 0

    def arrive(self) -> StreamHandler:
        """Return the handler of a new stream."""
        return _InboundStream(self)

    def expel(self, name: str, message: str) -> None:
        """Reject the connections that authenticate as this client, whose key or right has changed."""
        for pending in self.present:
            if pending.name == name:
                pending.reject(message)

    def shortage(self, message: str) -> None:
        """Tell the operator that no connection can be accepted now, and reject the pending one of the lowest stage."""
        if self.refusals.is_new("", message):
            text = f"new connections have to wait: {message}"
            self._context.log(Level.ERROR, EventCode.ENGINE_SHORTAGE, text)
        if self._present:  # the next connection needs a descriptor
            self._reject_lowest(self._present, "the server has no file descriptors left")

    def tick(self) -> None:
        """Once a second: forget old refusals, and tell the operator what strangers were refused for lack of room."""
        self.refusals.tick()
        turned_away = self.strangers.turned_away
        if turned_away > self._turned_away and self.refusals.is_new("", EventCode.LINK_STRANGERS):
            self._turned_away = turned_away
            text = f"{turned_away:,} connections or samples of strangers dropped: block the flood with a firewall"
            self._context.log(Level.WARNING, EventCode.LINK_STRANGERS, text)


class _InboundStream(PendingConnection, StreamHandler):
    rejected_code = EventCode.LINK_REJECTED

    def __init__(self, streams: InboundStreams) -> None:
        super().__init__(streams)
        self._admission = streams.admission
        self._connection: ServerConnection = streams.admission.connection()
        self._stream: Stream | None = None

    def connected(self, stream: Stream) -> None:
        self._stream = stream
        if not self._arrive(stream.host):
            self.reject(Rejected.TOO_MANY())

    def closed(self, reason: str) -> None:
        self._leave()

    def _why_overdue(self) -> tuple[Rejected, str]:
        if self._stream is None or self._stream.received_bytes:
            return super()._why_overdue()
        return Rejected.SENT_NOTHING, LinkCause.NO_ANSWER

    def received(self, data: bytes) -> None:
        stream, connection = self._stream, self._connection
        # The refusal may be delayed, and more may come until then.
        if stream is None or self.stage in (ConnectionStage.REFUSED, ConnectionStage.OVER):
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
                case StreamRefused(code, message, None):
                    message = self._for_operator(code, message)
                    self.name = self._admission.refused(self.name, stream, code, message)
                    cause = CAUSES.get(code, LinkCause.REFUSED)
                    self._refuse(_CODES.get(code, EventCode.LINK_REJECTED), message, answer, cause)
                    return
                case StreamRefused(code, message, Hello() as peer):
                    self._leave()
                    self._refuse_proven(stream, Refusal(code, message), peer)
                    return
                case Failed(reason, foreign):
                    if foreign is None:
                        self._refuse(EventCode.LINK_REJECTED, reason, answer)
                    else:
                        text = f"{reason}: {_ONLY_BRIDGES}"
                        self._refuse(EventCode.LINK_REJECTED, text, answer, LinkCause.NOT_A_BRIDGE)
                    return
                case _:
                    pass
        # The answer first, without a tag: before it the client has no key to check one (PROTOCOL.md, 12).
        stream.write(answer)
        if connection.accepted and self.stage < ConnectionStage.ACCEPTED:
            stream.authenticate(connection.sample_secret, opener=False)
            self._accept()

    def _established(self, stream: Stream, event: Established, more: list[Event]) -> None:
        try:
            control = self._admission.established(stream, self._connection, event)
        except Refusal as refusal:
            assert isinstance(event.peer, Hello)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            self._refuse_proven(stream, refusal, event.peer)
        else:
            stream.trust()
            control.receive(more)

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
            self._pending.refusals.log(stream, EventCode.LINK_REJECTED, refusal.message, refusal.link)
            stream.write(self._connection.refuse(refusal.code, refusal.message))
            stream.close(refusal.message)

    def _log(self, code: EventCode, message: str, cause: str = "", name: str = "") -> None:
        assert self._stream is not None
        self._pending.refusals.log(self._stream, code, message, name, cause)

    def _busy(self, message: str) -> bytes:
        return self._connection.refuse(RefusalCode.BUSY, message)

    def _close_with(self, answer: bytes, message: str) -> None:
        assert self._stream is not None
        self._stream.write(answer)
        self._stream.close(message)

    def _pause_reading(self) -> None:
        assert self._stream is not None
        self._stream.pause_reading()

    def _for_operator(self, code: RefusalCode, message: str) -> str:
        if code is RefusalCode.WRONG_KEY:
            return f"{message}: copy one side's key file to the other"
        if code is RefusalCode.UNKNOWN_NAME:
            return f"{message}: {self._admission.remedy_for_unknown(self.name)}"
        return message
