"""Measuring a link: the orders to a bridge, and the results."""

from __future__ import annotations

from typing import Literal

import msgspec

from rsb_bridge.feature_api import Command, Purpose, Right
from rsb_bridge.model.transports import Protocol

BENCH = Purpose("bench", fills_link=True, type_name="rsb_bridge/msg/Bench", type_hash="RIHS01_" + "0" * 64)
"""Messages that measure the link."""


class BenchmarkStep(msgspec.Struct, frozen=True, omit_defaults=True):
    """A step of a benchmark, which a bridge does.

    Attributes:
        what: ``run`` sends messages over a link; ``measure`` only reads the usage of the bridge's process so far;
            ``end`` closes its routes.
        link: name of the link, or an empty string for a client's, or a server's only one.
        transport: transport that carries the messages, or an empty string for the link's.
        direction: ``transmit`` goes from client to server.
        size: bytes of each message, at least `LEAST_SIZE`.
    """

    what: Literal["run", "measure", "end"] = "run"
    link: str = ""
    transport: Protocol | Literal[""] = ""
    direction: Literal["transmit", "receive"] = "transmit"
    size: int = 0
    rate: float = 0.0
    count: int = 0


LEAST_SIZE = 16
"""Bytes: the encapsulation and the sender's clock (docs/bench-protocol.md) have 12."""
MOST_SIZE = 16 << 20
"""Bytes; of the protocol (docs/bench-protocol.md: BenchAsk)."""
MOST_SECONDS = 30.0
"""Longest run, in seconds."""
REFUSED, STOPPED = "refused by the other side", "stopped by the other side"
ENDED_BY_PEER = (REFUSED, STOPPED)
"""Beginnings of the message if the peer ends a benchmark, or refuses it by its limits."""


class Usage(msgspec.Struct, frozen=True, omit_defaults=True):
    """Resources that a bridge's process has used so far.

    Attributes:
        cpu: s of processor time.
        memory: bytes of resident memory.
        sent_bytes: bytes handed to the sockets of all links.
        received_bytes: bytes read from the sockets of all links.
    """

    cpu: float = 0.0
    memory: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0


class Outcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """The result of an `BenchmarkStep`.

    Attributes:
        usage: usage of the process that did the step, at the end.
        rate: Hz that the sending side reached.
        p50: median latency from one end of the link to the other, in seconds.
        p99: 99th percentile of the latency, in seconds.
        p999: 99.9th percentile of the latency, in seconds.
        uncertainty: possible error of the latencies in seconds, because two machines' clocks differ, or None if
            unknown.
        sending: usage of the sending side's process during the run.
        receiving: usage of the receiving side's process during the run.
        most_rate: Hz that the peer allows, or 0 if it sets no limit.
    """

    usage: Usage
    sent: int = 0
    received: int = 0
    rate: float = 0.0
    p50: float = 0.0
    p99: float = 0.0
    p999: float = 0.0
    uncertainty: float | None = None
    sending: Usage = Usage()
    receiving: Usage = Usage()
    most_rate: float = 0.0


class Bench(Command[Outcome], frozen=True, tag="bench"):
    """Send messages over a link on an internal route, and measure them.

    The peer has to allow it (`rsb_extras.bench.LIMITS`). The route is removed some seconds after the last step.
    """

    right = Right.MEASURE
    order: BenchmarkStep
