"""Measuring a link with topics that no node has: their names, what may be asked for, and what comes of it."""

from __future__ import annotations

from typing import Literal

import msgspec

FEATURE = "bench"
"""What a side that can be measured names among its features."""
TYPE = "rsb_bridge/msg/Bench"
TYPE_HASH = "RIHS01_" + "0" * 64
_PART = "rsb_bench"


class Leave(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a peer that measures the link may cause, in any hour.

    Attributes:
        seconds: s in which it sends, or has this side send.
        max_rate: messages a second.
        megabytes: of payload.
    """

    seconds: float = 300.0
    max_rate: float = 20_000.0
    megabytes: float = 4_000.0


class Order(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a benchmark asks of a bridge.

    Attributes:
        what: ``run`` sends messages over a link; ``measure`` only looks what the bridge's process has used so far;
            ``end`` removes the topics of the link.
        link: which; empty: a client's, or a server's only one.
        transport: that carries the messages; empty: the link's.
        direction: ``transmit`` goes from client to server.
        size: bytes of each message, at least `LEAST_SIZE`.
        rate: Hz.
        count: of messages.
    """

    what: Literal["run", "measure", "end"] = "run"
    link: str = ""
    transport: Literal["", "tcp", "udp", "bluetooth", "zenoh", "zenoh-drop"] = ""
    direction: Literal["transmit", "receive"] = "transmit"
    size: int = 0
    rate: float = 0.0
    count: int = 0


LEAST_SIZE = 16
MOST_SIZE = 16 << 20
MOST_SECONDS = 30.0
"""s of one run."""
REFUSED, STOPPED = "refused by the other side", "stopped by the other side"
ENDED_BY_PEER = (REFUSED, STOPPED)
"""What the message begins with where the peer, or the leave that it gives, ends a benchmark."""


class Usage(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a bridge's process has used so far.

    Attributes:
        cpu: s of processor time.
        memory: bytes that are resident.
        sent_bytes: handed to the sockets of all links.
        received_bytes: likewise.
    """

    cpu: float = 0.0
    memory: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0


class Outcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """What came of an `Order`.

    Attributes:
        usage: of the process that was asked, at the end.
        sent: messages.
        received: messages.
        rate: Hz that the sending side reached.
        p50: s of latency, from one end of the link to the other, likewise those below.
        p99: s.
        p999: s.
        uncertainty: s by which these may be wrong, because the clocks of two machines differ; None: not known.
        sending: used by the sending side's process during the run.
        receiving: likewise.
        most_rate: Hz that the peer allows; 0: any.
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


def bench_topic(transport: str, direction: str) -> str:
    """The name of the topic that measures a transport in a direction, as the client sees it."""
    return f"/{_PART}/{transport.replace('-', '_')}/{direction}"


def is_bench_topic(topic: str) -> bool:
    """Whether a name is one of `bench_topic`'s, with or without a client's name before it."""
    parts = topic.split("/")
    return len(parts) > 3 and _PART in parts[1:3]
