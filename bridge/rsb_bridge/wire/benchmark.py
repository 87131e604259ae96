"""The control messages of a benchmark (PROTOCOL.md, 9)."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from msgspec import Meta

from rsb_bridge.model.benchmark import MOST_SIZE

# msgspec resolves the annotations at run time
from rsb_bridge.wire.fields import Count, Hertz, Reason, RouteId, Seconds  # noqa: TC001
from rsb_bridge.wire.message import ControlMessageBase

Size: TypeAlias = Annotated[int, Meta(ge=0, le=MOST_SIZE)]
Difference: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9)]


class BenchAsk(ControlMessageBase, frozen=True):
    """The side that measures: what has the other one counted, and used? Answered by a `BenchAnswer` of the same number.

    Attributes:
        request: counts up.
        route: of a topic that measures.
        reset: what arrives is counted from 0 on from now on.
        size: bytes of each message to be sent by the other side.
        rate: Hz of these.
        count: how many; 0: none.
    """

    request: Count
    route: RouteId
    reset: bool = False
    size: Size = 0
    rate: Hertz = 0.0
    count: Count = 0


class BenchAnswer(ControlMessageBase, frozen=True):
    """The answer to `BenchAsk`.

    Attributes:
        request: the question's.
        problem: why it is not done, for an operator; empty: it is.
        sent: messages that the last run has sent.
        rate: Hz that it has reached; 0: it is not over.
        received: messages since the last reset.
        p50: s on the two wall clocks, of these messages, likewise those below.
        p99: s.
        p999: s.
        cpu: s of processor time that the process has used.
        memory: bytes that it has.
        sent_bytes: handed to the sockets of its links.
        received_bytes: likewise.
        max_rate: Hz that the asker may cause; 0: any.
    """

    request: Count
    problem: Reason = ""
    sent: Count = 0
    rate: Hertz = 0.0
    received: Count = 0
    p50: Difference = 0.0
    p99: Difference = 0.0
    p999: Difference = 0.0
    cpu: Seconds = 0.0
    memory: Count = 0
    sent_bytes: Count = 0
    received_bytes: Count = 0
    max_rate: Hertz = 0.0
