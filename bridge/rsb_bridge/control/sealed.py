"""Operators who attach over a network, both ends: the network carries only sealed bytes.

The listener makes a stream of each inbound connection, and a protocol for it (`SealedAcceptor.protocol`), both on
`rsb_bridge.control.control_server.ControlServer.loop`. The stream is what asyncio calls a transport. It calls
``connection_made``, ``data_received``, ``eof_received`` and ``connection_lost`` of the protocol, in order and on that
loop. It has ``write``, ``close``, ``abort``, ``is_closing``, ``pause_reading``, ``get_write_buffer_size`` and
``get_extra_info``, whose ``"peername"`` says where the connection comes from, as a socket has it or as a text, true or
not. It may be closed and aborted again. A stream whose other end is gone has to call ``connection_lost``: nothing in
here asks whether it is there.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, TypeAlias, cast

from rsb_bridge.control import protocol
from rsb_bridge.control.attached_console import AttachedConsole
from rsb_bridge.control.control_sockets import ControlError, close_lingering
from rsb_bridge.control.protocol import ControlProtocolError
from rsb_bridge.link.pending_connections import ConnectionStage, Limits, PendingConnection, PendingConnections
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import ActingOperator
from rsb_bridge.model.fingerprints import fingerprint_of
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.streams import OpenNetworkTransport, break_cycles
from rsb_bridge.wire.connection import RECORD_CONTENT, OperatorConsole, OperatorEngine
from rsb_bridge.wire.events import Admitted, Failed, OperatorOpened, RefusalCode, StreamRefused
from rsb_bridge.wire.preamble import Refusal
from rsb_bridge.wire.sealed_stream import Credential, ReplayCache

if TYPE_CHECKING:
    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.operator_keys import Granted
    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.control.remote_engine import Connection
    from rsb_bridge.engine.access import Access

_PLACES = protocol.CONSOLES - 8
"""Places that operators may fill. The others are kept for consoles of this machine, which count here, too."""
_LIMITS = Limits(total=32, of_one_host=32, accepted=_PLACES)
"""For connections that have not authenticated. In some networks, a peer chooses its own address."""
_TOLD_WITHIN = 5.0
"""s in which a refusal has to be taken. A round figure: a peer that reads nothing keeps its connection for so long."""
_TICK = 1.0
_PEER_LENGTH = 80
_LINES, _LINES_A_SECOND = 64, 0.2
"""Of operators who come and go."""
_CODES = {
    RefusalCode.WRONG_KEY: EventCode.ATTACH_WRONG_KEY,
    RefusalCode.UNKNOWN_NAME: EventCode.ATTACH_UNKNOWN_NAME,
}
_REMEDIES = {
    RefusalCode.WRONG_KEY: "copy the operator's key file to both sides",
    RefusalCode.UNKNOWN_NAME: "the engine's session file lists who may attach, under operators",
}
_REFUSED_AFTER = 1.5
"""s from a refusal, which any member of some networks can forge, until it counts: the engine's answer may follow.
The same holds for a client's link (PROTOCOL.md, 12)."""
_READ_SIZE = 256 << 10
_HELD = 1 << 20
"""Bytes that wait to be read, of which twice as many stop the stream."""
_OPERATOR_REMEDIES = {
    RefusalCode.WRONG_KEY: "give the key file that the engine's session names for this operator",
    RefusalCode.UNKNOWN_NAME: "give the name of the engine's session, and a name under its operators",
}


class OperatorRefused(Wording):
    """Reasons why an operator is not attached over a network, or not any more."""

    UNKNOWN = "there is no operator {name!r}"
    OPERATORS_CHANGED = "the operators of this engine have changed meanwhile: try again"
    READ_ONLY = "{name} has read-only access (may: {may} in the bridge's operators)"
    ASKS_HOLDERS = "{name} may not take over at once (may: {may}, not take, in the bridge's operators)"
    REMOVED = "{name} may no longer attach: removed from the bridge's operators"
    BY_ENGINE = "{engine} refuses: {message}"
    BY_ENGINE_WITH_REMEDY = "{engine} refuses: {message}: {remedy}"
    FAILED = "{engine}: {problem}"


class SealedAcceptor:
    """Lets the operators of one engine in. All of it but `review` belongs to the server's loop.

    Args:
        server: serves the engine; it has to be started.
    """

    def __init__(self, server: ControlServer, access: Access) -> None:
        self.server = server
        self.access = access
        self.pending = PendingConnections(access, access.strangers, _LIMITS)
        self._lines = TokenBucket(_LINES, _LINES_A_SECOND, access.now())
        self._present: dict[SealedConsole, None] = {}
        self._replays: dict[bytes, ReplayCache] = {}  # by key
        self._ticking = False
        access.watch(self.review)
        server.at_end(self._close)

    def protocol(self) -> SealedConsole:
        """Return the protocol for a new connection's stream."""
        return SealedConsole(self)

    def review(self) -> None:
        """Detach those who may not attach any more, or may otherwise. From any thread."""
        with contextlib.suppress(RuntimeError):  # the server has ended
            self.server.loop.call_soon_threadsafe(self._review)

    # --- on the loop

    def add(self, console: SealedConsole) -> bool:
        """Record a new connection; return False if the server takes no more."""
        if self.server.ending or self.server.attached() >= 2 * protocol.CONSOLES:
            return False
        self._present[console] = None
        if not self._ticking:
            self._ticking = True
            self.server.loop.call_later(_TICK, self._tick)
        return True

    def remove(self, console: SealedConsole) -> None:
        """Forget a connection that has ended."""
        self._present.pop(console, None)

    def credential(self, name: str) -> Credential:
        """Return the proof that the operator of a name owes.

        Raises:
            Refusal: there is no such operator.
        """
        granted = self.access.granted.get(name)
        if granted is None:
            raise Refusal(RefusalCode.UNKNOWN_NAME, OperatorRefused.UNKNOWN(name=name))
        secret = granted.key.secret
        return Credential((secret,), self._replays.setdefault(secret, ReplayCache()))

    def came_or_went(self, code: EventCode, who: str, text: str) -> None:
        """Record that an operator has attached or detached."""
        if self._lines.take(1, self.access.now()):
            self.access.events.add(Level.INFO, code, text, who=who)

    def _close(self) -> None:
        for console in tuple(self._present):
            console.abort()

    def _review(self) -> None:
        granted = self.access.granted
        valid = {each.key.secret for each in granted.values()}
        self._replays = {key: replays for key, replays in self._replays.items() if key in valid}
        for console in tuple(self._present):
            console.review(granted.get(console.name))

    def _tick(self) -> None:
        self.pending.refusals.tick()
        self._ticking = bool(self._present)
        if self._ticking:
            self.server.loop.call_later(_TICK, self._tick)


class SealedConsole(PendingConnection, asyncio.Protocol):
    """A connection of an operator: pending at first, then a `rsb_bridge.control.attached_console.AcceptedConnection`.

    Attributes:
        when_attached: called once the operator has proven to have the key.
    """

    of_this_machine = False
    rejected_code = EventCode.ATTACH_REJECTED

    def __init__(self, acceptor: SealedAcceptor) -> None:
        super().__init__(acceptor.pending)
        self.when_attached: Callable[[], None] = _nothing
        self.operator = ActingOperator("", "")
        self._acceptor = acceptor
        self._machine: OperatorEngine
        self._peer = ""
        self._transport: asyncio.Transport
        self._granted: Granted | None = None
        self._console: AttachedConsole | None = None
        self._detached = False

    # --- what the stream calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        host, self._peer = _origin(transport.get_extra_info("peername"))
        at = transport.get_extra_info("sockname")[0] if isinstance(transport, OpenNetworkTransport) else ""
        self._machine = OperatorEngine(self._acceptor.access.name, self._acceptor.credential, at)
        if not self._acceptor.add(self) or not self._arrive(host, f"a console at {self._peer}"):
            self.abort()

    def data_received(self, data: bytes) -> None:
        # A refused connection stays open until its answer is sent.
        if (
            self._detached
            if self._console is not None
            else self.stage in (ConnectionStage.REFUSED, ConnectionStage.OVER)
        ):
            return
        events = self._machine.receive_data(data)
        self.name = self._machine.name
        answer = self._machine.data_to_send()
        for event in events:
            match event:
                case Admitted():
                    self._admit(event)
                case OperatorOpened(content):
                    self._receive(content)
                case StreamRefused(code, message):
                    text = f"{message}: {remedy}" if (remedy := _REMEDIES.get(code)) else message
                    self._refuse(_CODES.get(code, EventCode.ATTACH_REJECTED), text, answer)
                case Failed(reason):
                    self._fail(reason, answer)
                case _:
                    raise AssertionError("an event of links")
        # Otherwise the answer goes with a refusal, perhaps later.
        if not events:
            self._transport.write(answer)
            if self._machine.accepted and self.stage is ConnectionStage.WAITING:
                secret = self._machine.sample_secret
                if secret is not None and isinstance(self._transport, OpenNetworkTransport):
                    self._transport.authenticate(secret, opener=False)
                self._accept()

    def eof_received(self) -> bool:
        return False  # nobody stays who hears only

    def connection_lost(self, exc: Exception | None) -> None:
        self._detach()
        self._stop_waiting()
        self._acceptor.remove(self)
        break_cycles(self._transport)

    # --- before it is attached

    def review(self, granted: Granted | None) -> None:
        """Take over changed operators; `granted` has the rights of the operator of this name, or is None."""
        if self._console is None:
            if self._machine.accepted:
                self.reject(OperatorRefused.OPERATORS_CHANGED())
        elif granted is None:
            self._console.end(OperatorRefused.REMOVED(name=self.name))
        elif granted != self._granted:
            self._console.end(f"the rights or the key of {self.name} were changed on the bridge")

    def _admit(self, admitted: Admitted) -> None:
        self._granted = self._acceptor.access.granted.get(self.name)
        if self._granted is None or self._granted.key.secret != admitted.key:
            self.reject(OperatorRefused.OPERATORS_CHANGED())  # and the review of that is still to come
            return
        # Before `_leave`, which forgets it.
        self.when_attached()
        self._leave()
        place = f" from {admitted.host}" if admitted.host else ""
        self.operator = ActingOperator(f"key {fingerprint_of(admitted.key).hex()}", self.name, f"(operator key){place}")
        server = self._acceptor.server
        self._console = AttachedConsole(server, self, server.full(_PLACES))
        if isinstance(self._transport, OpenNetworkTransport):
            self._transport.when_doubted = self._console.doubted
        server.add(self._console)
        network = self._transport.network if isinstance(self._transport, OpenNetworkTransport) else ""
        way = f"{network} (id {self._peer})" if network else self._peer
        text = f"{self.operator} has attached through {way}, and may {self._granted.operator.may}"
        self._acceptor.came_or_went(EventCode.ATTACH_OPERATOR, str(self.operator), text)

    def _fail(self, reason: str, answer: bytes) -> None:
        """End a connection that broke the format or the seal."""
        if self._console is not None:
            self._log(EventCode.ATTACH_REJECTED, reason)
            self.abort()
        elif self.stage is not ConnectionStage.OVER:
            self._refuse(EventCode.ATTACH_REJECTED, reason, answer)

    def _busy(self, message: str) -> bytes:
        if self._machine.accepted:
            return b""  # the console has the answer, and accepts only records from now on
        return self._machine.refuse(RefusalCode.BUSY, message)

    def _close_with(self, answer: bytes, message: str) -> None:
        del message  # it is in the answer
        self._deadline = asyncio.get_running_loop().call_later(_TOLD_WITHIN, self._transport.abort)
        self._transport.write(answer)
        self._transport.close()

    def _pause_reading(self) -> None:
        self._transport.pause_reading()

    def _leave(self) -> None:
        super()._leave()
        self.when_attached = _nothing

    def _detach(self) -> None:
        """Leave the engine."""
        self._leave()
        if self._console is not None and not self._detached:
            self._detached = True
            self._acceptor.server.remove(self._console)
            text = f"{self.operator} has detached"
            self._acceptor.came_or_went(EventCode.ATTACH_OPERATOR_LEFT, str(self.operator), text)

    # --- once it is: the console's connection

    @property
    def read_only_reason(self) -> str:
        """The reason this operator may change nothing, or an empty string."""
        assert self._granted is not None
        may = self._granted.operator.may
        return OperatorRefused.READ_ONLY(name=self.name, may=may) if may == "look" else ""

    @property
    def never_takes_reason(self) -> str:
        """The reason this operator may take no arming from its holder without asking, or an empty string."""
        assert self._granted is not None
        may = self._granted.operator.may
        return "" if may == "take" else OperatorRefused.ASKS_HOLDERS(name=self.name, may=may)

    @property
    def buffered(self) -> int:
        """Bytes that wait for the operator's console."""
        return self._transport.get_write_buffer_size()

    @property
    def closing(self) -> bool:
        """Whether nothing can be sent any more."""
        return self._detached or self._transport.is_closing()

    def write(self, data: bytes) -> None:
        """Seal and send, record by record: some networks bring nothing of a write before all of it."""
        for at in range(0, len(data), RECORD_CONTENT):
            self._transport.write(self._machine.send(data[at : at + RECORD_CONTENT]))

    def close(self) -> None:
        """Close once what waits is sent."""
        self._transport.close()

    def close_lingering(self) -> None:
        """Close once what waits is sent, and the console has had time to read it."""
        close_lingering(self._transport, _TOLD_WITHIN)

    def abort(self) -> None:
        """Close, and forget what waits."""
        self._transport.abort()
        self._detach()

    def _receive(self, content: bytes) -> None:
        if self._console is None or self.closing:  # an earlier record ended it
            return
        try:
            self._console.received(content)
        except ControlProtocolError:  # as through the socket: what cannot be read ends it
            self.abort()


def _nothing() -> None:
    """Nobody waits for the operator's proof."""


def _origin(peername: object) -> tuple[str, str]:
    """Return the host that a connection comes from, and with its port, as a stream says; for a log."""
    if isinstance(peername, tuple) and len(peername) >= 2 and peername[1]:
        host, port = sanitize_text(str(peername[0]), _PEER_LENGTH), sanitize_text(str(peername[1]), _PEER_LENGTH)
        return host, f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    if isinstance(peername, tuple) and peername:  # what has no ports
        peername = peername[0]
    text = sanitize_text(str(peername or "an unknown place"), _PEER_LENGTH)
    return text, text


Connect: TypeAlias = Callable[[asyncio.Protocol], Awaitable[object]]
"""Makes a stream to the engine, and calls ``connection_made`` of the protocol with it on the running loop. The stream
is an asyncio transport. It raises OSError or ControlError if there is no stream."""


class OperatorConnector:
    """Connects to an engine over a network, with an operator's key.

    Args:
        operator: as the engine's session names them.
        engine: the name of the session that is meant: no other one can answer in its place.
        at: the engine's address in a network where engines announce themselves, or empty.
    """

    uid = None

    def __init__(self, connect: Connect, operator: str, key: Key, engine: str, at: str = "") -> None:
        self._connect = connect
        self._operator = operator
        self._key = key
        self._engine = engine
        self._at = at

    @property
    def text(self) -> str:
        return self._engine

    async def open(self, within: float) -> Connection:
        """Connect, and prove to each other who is there."""
        console = OperatorConsole(
            self._operator, self._key.secret, self._engine, version=protocol.VERSION, host=socket.gethostname()
        )
        connection = _OperatorConnection(console, self._engine, self._at)
        try:
            async with asyncio.timeout(within):
                await self._connect(connection)
                await connection.admitted
        except BaseException:
            connection.abort()
            raise
        return connection


class _OperatorConnection(asyncio.Protocol):
    """One connection: it opens records, and keeps their content until it is read."""

    def __init__(self, machine: OperatorConsole, engine: str, at: str) -> None:
        loop = asyncio.get_running_loop()
        self.admitted: asyncio.Future[None] = loop.create_future()
        self._machine = machine
        self._engine = engine
        self._at = at
        self._trial: OpenNetworkTransport | None = None
        self._refused = False
        self._reader = asyncio.StreamReader(_HELD, loop)
        self._transport: asyncio.Transport | None = None
        self._ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        if self._ended:  # given up meanwhile
            self._transport.abort()
            return
        self._reader.set_transport(self._transport)
        if isinstance(transport, OpenNetworkTransport):
            self._trial = transport
            transport.begin_trial()
        self._transport.write(self._machine.start())

    def data_received(self, data: bytes) -> None:
        if self._ended:
            return
        assert self._transport is not None
        if self._trial is not None and not self._prove(self._trial, data):
            return
        events = self._machine.receive_data(data)
        self._transport.write(self._machine.data_to_send())
        for event in events:
            match event:
                case Admitted():
                    if not self.admitted.done():
                        self.admitted.set_result(None)
                case OperatorOpened(content):
                    self._reader.feed_data(content)
                case StreamRefused() | Failed():
                    self._end(self._reason_of(event))
                case _:
                    raise AssertionError("an event of links")

    def _prove(self, transport: OpenNetworkTransport, data: bytes) -> bool:
        """Whether an answer proves the key; anybody in the network may answer, also in the engine's name."""
        machine = self._machine.fork()
        events = machine.receive_data(data)
        if machine.proven and machine.at == self._at:
            transport.adopt()
            self._trial = None
            if machine.sample_secret is not None:
                transport.authenticate(machine.sample_secret, opener=True)
            return True
        for event in events:
            if isinstance(event, StreamRefused | Failed) and not self._refused:
                self._refused = True
                asyncio.get_running_loop().call_later(_REFUSED_AFTER, self._refuse, event)
        return False

    def _refuse(self, event: StreamRefused | Failed) -> None:
        """End the connection because of a refusal that no other answer has followed in time."""
        if self._trial is not None and not self._ended:
            self._end(self._reason_of(event))

    def _reason_of(self, event: StreamRefused | Failed) -> str:
        if isinstance(event, StreamRefused):
            remedy = _OPERATOR_REMEDIES.get(event.code, "")
            text = OperatorRefused.BY_ENGINE_WITH_REMEDY if remedy else OperatorRefused.BY_ENGINE
            return text(engine=self._engine, message=event.message, remedy=remedy)
        return OperatorRefused.FAILED(engine=self._engine, problem=event.reason)

    def eof_received(self) -> bool:
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        if self._ended:
            return
        if exc is not None:
            self._end(OperatorRefused.FAILED(engine=self._engine, problem=getattr(exc, "strerror", None) or exc))
        elif not self.admitted.done():
            self._end(f"{self._engine} closed the connection without an answer")
        else:
            self._ended = True
            self._reader.feed_eof()

    def _end(self, reason: str) -> None:
        """End the connection, and fail all who wait for it."""
        error = ControlError(reason)
        self._ended = True
        self._reader.set_exception(error)
        if not self.admitted.done():
            self.admitted.set_exception(error)
            self.admitted.exception()  # marks it as retrieved: it is no error if nobody waits
        if self._transport is not None:
            self._transport.abort()

    async def read(self) -> bytes:
        """Read, write and abort as in `rsb_bridge.control.remote_engine.Connection`."""
        return await self._reader.read(_READ_SIZE)

    def write(self, data: bytes) -> None:
        """Seal and send."""
        if not self._ended and self._transport is not None and not self._transport.is_closing():
            self._transport.write(self._machine.send(data))

    def abort(self) -> None:
        """Close, and forget what waits."""
        self._ended = True
        self.admitted.cancel()
        if self._transport is not None:
            self._transport.abort()
