"""How every stream begins: with preamble frames, one by one (PROTOCOL.md, 1.1)."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from enum import Enum, auto
from typing import TYPE_CHECKING

from rsb_bridge.wire.events import Event, Failed, Refused
from rsb_bridge.wire.framing import ProtocolError, pack_frame
from rsb_bridge.wire.preamble import Kind, Refusal, RefusalCode, parse_preamble, parse_refuse, refuse_frame, take_frame
from rsb_bridge.wire.protocol_error import ForeignProtocolError
from rsb_bridge.wire.sealing import SealError

if TYPE_CHECKING:
    from typing import Self

    from rsb_bridge.wire.handshake import Handshake
    from rsb_bridge.wire.sealing import Buffer


class Phase(Enum):
    """What comes next on a stream."""

    PREAMBLE = auto()  # preamble frames, one by one
    SEALED = auto()  # sealed frames
    HANDED_OVER = auto()  # a data stream, whose bytes go to the caller
    OVER = auto()


class PreambleStream(ABC):
    """What every end of a stream shares: the preamble, and failures."""

    _is_server = False

    def __init__(self) -> None:
        self._phase = Phase.PREAMBLE
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._events: list[Event] = []

    def receive_data(self, data: Buffer) -> list[Event]:
        """Take the next bytes of the stream; `data` must not be changed afterwards."""
        self._events = []
        try:
            self._take_in(data)
        except Refusal as refusal:
            self._refuse(refusal.code, refusal.message)
            self._end(Refused(refusal.code, refusal.message))
        except (ProtocolError, SealError) as error:
            if self._is(Phase.PREAMBLE):
                self._refuse(RefusalCode.BAD_FORMAT, str(error))
            foreign = error.protocol if isinstance(error, ForeignProtocolError) else None
            self._end(Failed(str(error), foreign))
        return self._events

    def _fork(self, handshake: Handshake) -> tuple[Self, Handshake]:
        """Return a copy of a client's end that has sent its first message, and of its handshake."""
        other = copy.copy(self)
        other._inbox, other._outbox, other._events = bytearray(), bytearray(), []
        return other, copy.copy(handshake)

    def data_to_send(self) -> bytes:
        """The bytes to write now; returned once."""
        data, self._outbox = bytes(self._outbox), bytearray()
        return data

    def leftover(self) -> bytes:
        """What came after a data stream's preamble, once it is accepted; returned once."""
        data, self._inbox = bytes(self._inbox), bytearray()
        return data

    def _take_in(self, data: Buffer) -> None:
        if self._is(Phase.OVER):
            return
        self._inbox += data
        while self._is(Phase.PREAMBLE) and (frame := take_frame(self._inbox)) is not None:
            self._on_preamble(*parse_preamble(frame), frame)

    def _is(self, phase: Phase) -> bool:
        return self._phase is phase

    @abstractmethod
    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        """Act on one preamble frame; `frame` is the whole of it."""

    def _refuse(self, code: RefusalCode, message: str) -> None:
        if self._is_server:  # a client has no frame for it
            self._outbox += pack_frame(refuse_frame(code, message))

    def _refused_by_peer(self, body: bytes) -> None:
        code, message = parse_refuse(body)
        self._end(Refused(code, message))

    def _end(self, event: Event) -> None:
        self._phase = Phase.OVER
        self._events.append(event)
