"""The frames of a route of calls: what stands before a serialized request, response or message (PROTOCOL.md, 8)."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from rsb_bridge.wire.framing import ProtocolError

_HEADER = struct.Struct(">BBQQ")
CALL_HEADER_LENGTH = _HEADER.size
MOST_TOOK = 2**63 - 1
"""ns; whoever has asked knows a lower bound: the time since then."""


class What(IntEnum):
    """What a frame is."""

    CALL = 1
    """A request, from the callers' side."""
    ANSWER = 2
    """A response, from the providing side."""
    REFUSED = 3
    """The providing side will not answer a call; the content says why, in UTF-8."""
    MESSAGE = 4
    """A message of a lane that is a topic, from the providing side."""
    AGAIN = 5
    """A request that was under way in an earlier opening of the route, of an action, whose goals have ids."""


_KINDS = frozenset(What)


class CallFrame(NamedTuple):
    """One frame.

    Attributes:
        what: of the five.
        lane: its place among the lanes of the route's kind.
        call: of the callers' side, counting up from 1 in each opening of the route; 0: it is a message.
        took: of an answer, ns that the providing node took for it, as the bridge beside it saw it; else 0.
        content: the serialized message (CDR with its encapsulation header), or why a call is refused.
        lease: the number in the lease header before the frame, or 0 without one.
        stamp: ns, from which the age of a request counts, by the clock of the side that sends it; 0: it has none. It is
            the stamp of the message that carries the frame.
    """

    what: What
    lane: int
    call: int
    took: int
    content: bytes
    lease: int = 0
    stamp: int = 0

    def pack(self) -> bytes:
        """The frame as bytes."""
        return _HEADER.pack(self.what, self.lane, self.call, self.took) + self.content


def unpack_call(payload: bytes) -> CallFrame:
    """The frame that a route's message is.

    Raises:
        ProtocolError: it is too short, of no known kind, or a message with the number of a call, or a call without one,
            or it says how long a node took for what is no answer, or longer than `MOST_TOOK`.
    """
    if len(payload) < CALL_HEADER_LENGTH:
        raise ProtocolError(f"a frame of calls has at least {CALL_HEADER_LENGTH} bytes, not {len(payload)}")
    what, lane, call, took = _HEADER.unpack_from(payload)
    if what not in _KINDS:
        raise ProtocolError(f"a frame of calls of kind {what}")
    if (call == 0) != (what == What.MESSAGE):
        raise ProtocolError(f"a frame of calls of kind {what} with the number {call}")
    if took > (MOST_TOOK if what == What.ANSWER else 0):
        raise ProtocolError(f"a frame of calls of kind {what} that took {took} ns")
    return CallFrame(What(what), lane, call, took, payload[CALL_HEADER_LENGTH:])
