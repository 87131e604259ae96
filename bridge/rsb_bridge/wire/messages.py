"""The control messages, typed (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import Annotated, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

from rsb_bridge.model.limits import RATE, STALE_AFTER
from rsb_bridge.model.qos import Qos  # noqa: TC001 - msgspec resolves the annotation at run time
from rsb_bridge.model.sources import MOST_SOURCES
from rsb_bridge.wire.fields import (  # noqa: TC001 - msgspec resolves the annotations at run time
    Bridges,
    Compression,
    Count,
    DescriptionText,
    Features,
    Hertz,
    LinkId,
    Name,
    Nanoseconds,
    NewestNumbers,
    Port,
    PublisherIds,
    Reason,
    RefuseCode,
    RouteId,
    Seconds,
    StaleAfter,
    Transport,
)
from rsb_bridge.wire.framing import ProtocolError
from rsb_bridge.wire.records import ReceivedReport, SentReport, Source, TopicEntry, check_qos


class _Message(msgspec.Struct, frozen=True, tag_field="message", tag=str.lower):
    """One control message: a msgpack map whose `message` is the type's name in lower case."""


class Hello(_Message, frozen=True):
    """The client, in the handshake.

    Attributes:
        version: of its software.
        name: of its session; the same as in the preamble.
        instance: random, new with each start of the process.
        domain_id: its ROS domain.
        features: what it can do beyond version 2; none yet.
        host: what its machine calls itself, for operators; empty: not known.
    """

    version: Name
    name: Name
    instance: Name
    domain_id: Count
    features: Features = ()
    host: Name = ""


class Welcome(_Message, frozen=True):
    """The server, in the handshake.

    Attributes:
        version: of its software.
        name: of its session.
        link_id: 8 random bytes that name this link.
        instance: random, new with each start of the process.
        domain_id: its ROS domain.
        features: what it can do beyond version 2; none yet.
        use_name: it puts the client's name before the names of this client's topics.
    """

    version: Name
    name: Name
    link_id: LinkId
    instance: Name
    domain_id: Count
    features: Features = ()
    use_name: bool = False


class Propose(_Message, frozen=True, kw_only=True):
    """Either side: bridge this topic. Answered by `Accept` or `Refuse`.

    Attributes:
        route: its id from now on; a client's are odd, a server's even, and none is used twice in a link's life.
        topic: its name on the sending side.
        remote_topic: its name on the receiving side.
        from_client: the client sends; else the server does.
        type: ``pkg/msg/Name``; empty: from either side's graph.
        transport: what carries it.
        port: a socket of its own; 0: the shared one.
        qos: None: as the topic's publishers offer.
        compression: of each message, by the sender.
        max_rate: Hz; 0: unlimited.
        expected_rate: Hz, shown to operators; 0: each side learns it.
        stale_after: s; 0: never warn; None: each side's own default.
        paused: begin paused.
        pause_revision: of `paused`; see `Pause`.
    """

    route: RouteId
    topic: Name
    remote_topic: Name
    from_client: bool
    type: Name = ""
    transport: Transport = "tcp"
    port: Port = 0
    qos: Qos | None = None
    compression: Compression = "none"
    max_rate: Hertz = 0.0
    expected_rate: Hertz = 0.0
    stale_after: StaleAfter | None = None
    paused: bool = False
    pause_revision: Count = 0

    def __post_init__(self) -> None:
        check_qos(self.qos, depth_known=True)
        _check_limits(self)


class Accept(_Message, frozen=True):
    """A `Propose` is accepted.

    Attributes:
        route: route id.
        topic: its name on the acceptor's side, which may add a prefix to the proposed one.
    """

    route: RouteId
    topic: Name


class Refuse(_Message, frozen=True):
    """A `Propose` is refused, or an accepted route turns out to be impossible.

    Attributes:
        route: route id.
        code: why.
        reason: why, for an operator.
    """

    route: RouteId
    code: RefuseCode
    reason: Reason


class Describe(_Message, frozen=True):
    """The sending side describes the messages that it will send.

    Attributes:
        route: route id.
        type: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``; may be empty.
        qos: to publish with; a depth of 0: as the messages themselves say (`rsb_bridge.wire.history`), or as the
            receiver likes.
        sources: what to have publishers for, by number. Described again, there may be more of them, never fewer.
    """

    route: RouteId
    type: Name
    type_hash: Name
    qos: Qos
    sources: Annotated[tuple[Source, ...], Meta(min_length=1, max_length=MOST_SOURCES)]

    def __post_init__(self) -> None:
        check_qos(self.qos)


class Ready(_Message, frozen=True):
    """The receiving side has publishers, and the sending side may send. Answers each `Describe`.

    Attributes:
        route: route id.
        sources: there are publishers for the first so many of them.
        before: counts of the last incarnation in which anything came from this process of the peer; its route id names
            that incarnation.
        newest: of a latched topic's publishers on the sending side, the number of the newest message published here.
    """

    route: RouteId
    sources: Count
    before: ReceivedReport | None = None
    newest: NewestNumbers = {}


class Publishers(_Message, frozen=True):
    """The sending side of a latched topic: which publishers are there; after each `Ready`, and when they change.

    Attributes:
        route: which.
        present: their ids. The histories of others may be dropped after a while.
    """

    route: RouteId
    present: PublisherIds


class Neighbours(_Message, frozen=True):
    """Either side, before anything else and again when it changes: which bridges are in its domain.

    Attributes:
        bridges: the names of their nodes, its own first.
    """

    bridges: Bridges


class Close(_Message, frozen=True):
    """Either side: the route ends.

    Attributes:
        route: route id.
        reason: why, for an operator.
        removed: for good; else its proposer opens it again.
    """

    route: RouteId
    reason: Reason
    removed: bool = False


class Amend(_Message, frozen=True):
    """The route goes on with other limits; the fields are those of `Propose`.

    The route's proposer decides: it tells what holds from now on. The other side asks it by the same message, and
    changes nothing before the proposer has answered.
    """

    route: RouteId
    max_rate: Hertz = 0.0
    expected_rate: Hertz = 0.0
    stale_after: StaleAfter | None = None

    def __post_init__(self) -> None:
        _check_limits(self)


class Pause(_Message, frozen=True):
    """Either side: the route pauses or resumes.

    Attributes:
        route: route id.
        paused: it pauses; else it resumes.
        revision: of the change that led to this state: above all that the side that made it had seen. The higher one
            counts on both sides, and of two equal ones the client's.
    """

    route: RouteId
    paused: bool
    revision: Count


class Ping(_Message, frozen=True):
    """Either side asks whether the peer is alive, and what time it has.

    Attributes:
        n: counts up.
        sent: ns since the epoch on the sender's clock.
    """

    n: Count
    sent: Nanoseconds


class Pong(_Message, frozen=True):
    """The answer to a `Ping`: the first three of an exchange's four times (RFC 5905, section 8).

    Attributes:
        n: from the ping.
        sent: from the ping.
        received: ns since the epoch on the answerer's clock, when the ping came.
        answered: likewise, when this was sent.
    """

    n: Count
    sent: Nanoseconds
    received: Nanoseconds
    answered: Nanoseconds


class Report(_Message, frozen=True):
    """Either side: its counts, once a second.

    Attributes:
        sent: of the routes that it sends on.
        received: of those that it receives on.
    """

    sent: tuple[SentReport, ...]
    received: tuple[ReceivedReport, ...]


class ListTopics(_Message, frozen=True):
    """Either side asks for the peer's topics. Answered by a `TopicList` with the same request number."""

    request: Count


class TopicList(_Message, frozen=True):
    """The answer to `ListTopics`."""

    request: Count
    topics: tuple[TopicEntry, ...]


class AskType(_Message, frozen=True):
    """Either side asks for the description of a route's type. Answered by a `TypeText`.

    Attributes:
        route: route id.
    """

    route: RouteId


class TypeText(_Message, frozen=True):
    """The answer to `AskType`.

    Attributes:
        route: route id.
        text: the description, zstd-compressed (`rsb_bridge.cdr.description`); empty: this side does not know it.
    """

    route: RouteId
    text: DescriptionText = b""


class Shutdown(_Message, frozen=True):
    """Either side: this link ends on purpose.

    Attributes:
        reason: why, for an operator.
        retry_after: s until the client may call again; None: it waits for its operator.
    """

    reason: Reason
    retry_after: Seconds | None = 0.0


ControlMessage: TypeAlias = (
    Propose
    | Accept
    | Refuse
    | Describe
    | Ready
    | Publishers
    | Neighbours
    | Close
    | Amend
    | Pause
    | Ping
    | Pong
    | Report
    | ListTopics
    | TopicList
    | AskType
    | TypeText
    | Shutdown
)


def _check_limits(message: Propose | Amend) -> None:
    if any(rate and rate not in RATE for rate in (message.max_rate, message.expected_rate)):
        raise ValueError(f"a rate is 0 or {RATE} Hz")
    if message.stale_after and message.stale_after not in STALE_AFTER:
        raise ValueError(f"stale_after is 0 or {STALE_AFTER} s")


_T = TypeVar("_T")

_encoder = msgspec.msgpack.Encoder()
_control: msgspec.msgpack.Decoder[ControlMessage] = msgspec.msgpack.Decoder(ControlMessage)
_hello = msgspec.msgpack.Decoder(Hello)
_welcome = msgspec.msgpack.Decoder(Welcome)


def encode(message: ControlMessage | Hello | Welcome) -> bytes:
    """A message as msgpack."""
    return _encoder.encode(message)


def decode(data: bytes) -> ControlMessage:
    """A control message from msgpack.

    Raises:
        ProtocolError: the message is invalid, or a field is out of its range.
    """
    return _decode(_control, data)


def decode_hello(data: bytes) -> Hello:
    """A `Hello` from msgpack; errors as `decode`."""
    return _decode(_hello, data)


def decode_welcome(data: bytes) -> Welcome:
    """A `Welcome` from msgpack; errors as `decode`."""
    return _decode(_welcome, data)


def _decode(decoder: msgspec.msgpack.Decoder[_T], data: bytes) -> _T:
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(f"invalid control message: {error}") from None
