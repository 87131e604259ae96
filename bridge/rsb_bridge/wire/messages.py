"""The control messages, typed (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.calls import MOST_LANES
from rsb_bridge.model.names import MOST_SOURCES
from rsb_bridge.model.patterns import NAMES_FOLLOWED, PATTERNS_PER_LINK
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.transports import Compression, Protocol
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.headers import LeaseNumber
from rsb_bridge.wire.records import (
    Bridges,
    CallsReport,
    Count,
    DescriptionText,
    FeatureNames,
    FullRecord,
    Hertz,
    HistoryDepths,
    LaneEntry,
    LinkId,
    MaybeHops,
    Name,
    Nanoseconds,
    NewestNumbers,
    NodeNames,
    PathRecord,
    Port,
    Rank,
    Reason,
    ReceivedReport,
    RefuseCode,
    RouteId,
    Seconds,
    SentReport,
    Shift,
    Source,
    check_limits,
    check_qos,
)


class ControlMessageBase(msgspec.Struct, frozen=True, tag_field="message", tag=str.lower):
    """One control message: a msgpack map whose `message` is the type's name in lower case."""


class Hello(ControlMessageBase, frozen=True):
    """The client, in the handshake.

    Attributes:
        name: of its session; the same as in the preamble.
        instance: random, new with each start of the process.
        host: its machine's host name, for operators, or empty if unknown.
        features: the names of its features (`rsb_bridge.feature`); only what both sides have is used.
    """

    version: Name
    name: Name
    instance: Name
    domain_id: Count
    host: Name = ""
    features: FeatureNames = ()


class Welcome(ControlMessageBase, frozen=True):
    """The server, in the handshake.

    Attributes:
        link_id: 8 random bytes that name this link.
        instance: random, new with each start of the process.
        use_name: whether it puts the client's name before the names of this client's topics.
        taken: text on the client that has the name already, or empty. This client confirms, and is refused.
        shut_down: text on the operator who has shut the link down, or empty. The client confirms, and is refused.
        at: its address in a Zenoh network, or empty. A client that reached it at another address was misled.
        features: as in `Hello`.
    """

    version: Name
    name: Name
    link_id: LinkId
    instance: Name
    domain_id: Count
    use_name: bool = False
    taken: Reason = ""
    shut_down: Reason = ""
    at: Name = ""
    features: FeatureNames = ()


class Propose(ControlMessageBase, frozen=True, kw_only=True):
    """Either side: bridge this topic. Answered by `Accept` or `Refuse`.

    Attributes:
        route: its id from now on; a client's are odd, a server's even, and none is used twice in a link's life.
        topic: its name on the sending side.
        remote_topic: its name on the receiving side.
        from_client: whether the client sends; else the server does.
        type: ``pkg/msg/Name``, or empty for the type in either side's graph.
        port: the port of its own socket, or 0 for the shared one.
        qos: the QoS, or None for the publishers' offer.
        compression: the sender's, for each message.
        max_rate: Hz, or 0 for no limit.
        expected_rate: Hz, shown to operators, or 0 if each side learns it.
        stale_after: s, 0 to never warn, or None for each side's own default.
        late_after: s, 0 for no limit, or None for each side's own default.
        max_age: s that a message may be old when it is published, 0 for no limit, or None if the proposer's session
            sets none.
        pause_revision: of `paused`; see `Pause`.
        arm: whether the proposer's session requires arming before anything crosses.
        deadman: s without a key after which it disarms, or 0 for none.
        on_end: the message that the receiving side publishes once an arming ends, by the proposer's session: ``zero``,
            ``none``, the JSON of its fields, or empty if the session says nothing.
        limits: what a hand may ask, by the proposer's session, or None for any velocity.
        who: the operator who has just added or edited the topic, or empty if unknown.
        place: where the proposer's session lists it, for operators: ``topics[2] of robot1.yaml``.
        by_pattern: whether a pattern of the proposer's has made it. An entry that names it goes before it.
        kind: a key of `rsb_bridge.model.calls.LANES`; another kind is a newer peer's, and refused. For calls, the
            "sending side" is the callers'.
        timeout: s until a call without an answer is given up, or 0 for 30 s and for topics.
        priority: of a topic, `rsb_bridge.model.session.RANKS`.
        purpose: a name of `rsb_bridge.model.purposes.purposes`; another one is a newer peer's, and refused.
    """

    route: RouteId
    topic: Name
    remote_topic: Name
    from_client: bool
    type: Name = ""
    transport: Protocol = "tcp"
    port: Port = 0
    qos: Qos | None = None
    compression: Compression = "none"
    max_rate: Hertz = 0.0
    expected_rate: Hertz = 0.0
    stale_after: Seconds | None = None
    paused: bool = False
    pause_revision: Count = 0
    arm: bool = False
    deadman: Seconds = 0.0
    who: Name = ""
    place: Name = ""
    by_pattern: bool = False
    kind: Name = "topic"
    timeout: Seconds = 0.0
    priority: Rank = 0
    late_after: Seconds | None = None
    max_age: Seconds | None = None
    on_end: Name = ""
    limits: VelocityLimits | None = None
    purpose: Name = "topic"

    def __post_init__(self) -> None:
        check_qos(self.qos, depth_known=True)
        check_limits(self)


class Accept(ControlMessageBase, frozen=True):
    """A `Propose` is accepted.

    Attributes:
        topic: its name on the acceptor's side, which may add a prefix to the proposed one.
        arm, deadman, max_age, on_end, limits: as in `Propose`, by the acceptor's session.
    """

    route: RouteId
    topic: Name
    arm: bool = False
    deadman: Seconds = 0.0
    max_age: Seconds | None = None
    on_end: Name = ""
    limits: VelocityLimits | None = None

    def __post_init__(self) -> None:
        check_limits(self)


class Refuse(ControlMessageBase, frozen=True):
    """The refusal of a `Propose`, or of an accepted route that turns out to be impossible."""

    route: RouteId
    code: RefuseCode
    reason: Reason


class Describe(ControlMessageBase, frozen=True):
    """The sending side describes the messages that it will send.

    Attributes:
        type_hash: ``RIHS01_...``; may be empty.
        qos: to publish with; a depth of 0: as the messages themselves say (`rsb_bridge.wire.headers`), or as the
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


class Ready(ControlMessageBase, frozen=True):
    """The receiving side has publishers, and the sending side may send. Answers each `Describe`.

    Attributes:
        sources: there are publishers for the first so many of them.
        before: counts of the last incarnation in which anything came from this process of the peer; its route id names
            that incarnation.
        newest: of a latched topic's publishers on the sending side, the number of the newest message published here.
    """

    route: RouteId
    sources: Count
    before: ReceivedReport | None = None
    newest: NewestNumbers = msgspec.field(default_factory=dict)


class Publishers(ControlMessageBase, frozen=True):
    """The sending side's publishers, if they are latched or have a lease; after each `Ready`, and when they change.

    Attributes:
        present: how many messages each latched one keeps for late joiners, by its id, or 0 while that is unknown. The
            histories of others may be dropped after a while.
        alive: whether one of them is alive, by its liveliness lease: then the receiving side asserts its own.
    """

    route: RouteId
    present: HistoryDepths
    alive: bool = False


class Provide(ControlMessageBase, frozen=True):
    """The providing side of a route of calls: its providers; after `Accept`, and whenever they change.

    Attributes:
        lanes: in the order of the kind (`rsb_bridge.model.calls`), or empty if nothing can be called now.
        nodes: some of the providing nodes.
        via: if the provider is a bridge itself, the hops between it and the answering node (section 5).
        pause_revision: the revision of the sender's pause; see `Pause`.
    """

    route: RouteId
    lanes: Annotated[tuple[LaneEntry, ...], Meta(max_length=MOST_LANES)] = ()
    nodes: NodeNames = ()
    via: MaybeHops = ()
    pause_revision: Count = 0


class Neighbours(ControlMessageBase, frozen=True):
    """Either side, before anything else and again when it changes: which bridges are in its domain.

    Attributes:
        bridges: the names of their nodes, its own first.
    """

    bridges: Bridges


class Close(ControlMessageBase, frozen=True):
    """Either side: the route ends.

    Attributes:
        code: whether it is removed, or edited, or its data connection has ended, and how.
        who: the operator who has removed it, or empty if unknown.
    """

    route: RouteId
    reason: Reason
    code: EndCode = EndCode.DECIDED
    who: Name = ""


class Ping(ControlMessageBase, frozen=True):
    """A question of either side: whether the peer is alive, and its time.

    Attributes:
        sent: ns since the epoch on the sender's clock.
    """

    n: Count
    sent: Nanoseconds


class Pong(ControlMessageBase, frozen=True):
    """The answer to a `Ping`: the first three of an exchange's four times (RFC 5905, section 8).

    Attributes:
        received: ns since the epoch on the answerer's clock, when the ping came.
        answered: ns since the epoch on the answerer's clock, when this was sent.
        shift: ns to add to the answerer's times. The sums follow a clock that is never set, as do the stamps of its
            messages.
    """

    n: Count
    sent: Nanoseconds
    received: Nanoseconds
    answered: Nanoseconds
    shift: Shift = 0


class Report(ControlMessageBase, frozen=True):
    """Either side: its counts, once a second.

    Attributes:
        sent: counts of the routes that it sends on.
        received: counts of the routes that it receives on.
        calls: counts of the routes of calls, in both directions.
        full: the rates of a full link in the direction of the message, or None if unchanged.
        path: what the path loses in the direction of the message, or None if unchanged.
    """

    sent: tuple[SentReport, ...]
    received: tuple[ReceivedReport, ...]
    calls: tuple[CallsReport, ...] = ()
    full: FullRecord | None = None
    path: PathRecord | None = None


class Duplicate(ControlMessageBase, frozen=True):
    """The server: a second client has the name and the key of this one, and is refused.

    Attributes:
        address: the second client's, or empty once it no longer tries.
        host: its machine's host name, or empty.
        others: number of further such clients, as far as the server counts.
    """

    address: Name = ""
    host: Name = ""
    others: Count = 0


class Shutdown(ControlMessageBase, frozen=True):
    """Either side: this link ends on purpose.

    Attributes:
        retry_after: s until the client may call again, or None if an operator has shut the link down.
    """

    reason: Reason
    retry_after: Seconds | None = 0.0


class ListTopics(ControlMessageBase, frozen=True):
    """Either side asks for the topics, services and the like of the peer's graph.

    Answered by a `TopicList` with the same request number.
    """

    request: Count


class TopicList(ControlMessageBase, frozen=True):
    """The answer to `ListTopics`.

    Attributes:
        topics: the entries (`rsb_bridge.wire.codec.pack_topics`).
    """

    request: Count
    topics: Annotated[bytes, Meta(max_length=CONTROL_LIMIT)]


class AskType(ControlMessageBase, frozen=True):
    """Either side asks for the descriptions of a route's types. Answered by a `TypeText`."""

    route: RouteId


class TypeText(ControlMessageBase, frozen=True):
    """The answer to `AskType`.

    Attributes:
        text: the descriptions (`rsb_bridge.cdr.description`), one a line, zstd-compressed, or empty if there are none.
    """

    route: RouteId
    text: DescriptionText = b""


class Amend(ControlMessageBase, frozen=True):
    """The route goes on with other limits. Its fields are as in `Propose`.

    Its proposer sends it; the other side asks for other limits by `Edit`. `who` is the operator who changes them, or
    empty if unknown.
    """

    route: RouteId
    max_rate: Hertz = 0.0
    expected_rate: Hertz = 0.0
    stale_after: Seconds | None = None
    who: Name = ""
    priority: Rank = 0
    late_after: Seconds | None = None
    max_age: Seconds | None = None

    def __post_init__(self) -> None:
        check_limits(self)


class Edit(ControlMessageBase, frozen=True, kw_only=True):
    """The side that did not propose a route asks its proposer to change the entry. Answered by `EditAnswer`.

    Attributes:
        number: of this question among its sender's.
        route: the route's present or last opening.
        seen: a proposal of the entry as the sender sees it.
        wanted: the same with changes. What differs is changed, except `arm`, `deadman`, `on_end` and `limits`, which
            each session demands for itself.
        who: the operator who edits it, or empty if unknown.
    """

    number: Count
    route: RouteId
    seen: Propose
    wanted: Propose
    who: Name = ""


class EditAnswer(ControlMessageBase, frozen=True):
    """The answer to `Edit`.

    Attributes:
        problem: the reason why the entry stays as it was, or empty if it was changed.
    """

    number: Count
    problem: Reason = ""


class Limit(ControlMessageBase, frozen=True):
    """Either side: a limit of its own on the route's rate, in addition to the proposer's.

    Attributes:
        max_rate: Hz, or 0 for no limit.
    """

    route: RouteId
    max_rate: Hertz = 0.0

    def __post_init__(self) -> None:
        check_limits(self)


class Pause(ControlMessageBase, frozen=True):
    """Either side: the route pauses or resumes.

    Attributes:
        paused: whether it pauses; else it resumes.
        revision: the change's number, above all numbers that its side had seen. The highest revision counts on both
            sides, and of two equal ones the client's.
        who: the operator who made the change, or empty if no longer known.
    """

    route: RouteId
    paused: bool
    revision: Count
    who: Name = ""


class Arm(ControlMessageBase, frozen=True):
    """Either side: an operator arms the route, which the other side answers by `Armed`.

    Sent again, once a second at most, when that operator has pressed a key.

    Attributes:
        route: route id. Under one id a route is armed once.
        who: the operator, in words.
    """

    route: RouteId
    who: Name = ""


class Armed(ControlMessageBase, frozen=True):
    """The answer to `Arm`: from now on both sides treat the route as armed."""

    route: RouteId


class Disarm(ControlMessageBase, frozen=True):
    """Either side: the route is not armed any more, or cannot be armed under this id. Its proposer opens it again.

    Attributes:
        cause: the reason's stable name.
        who: the operator who disarmed it, or empty if no operator did.
    """

    route: RouteId
    cause: Name
    who: Name = ""


ArmingMessage: TypeAlias = Arm | Armed | Disarm


class AskForArming(ControlMessageBase, frozen=True):
    """Either side: an operator asks the holder, an operator of either side, for the arming of a route.

    Attributes:
        number: of this question among its sender's.
        who: the operator who asks, in words.
    """

    route: RouteId
    number: Count
    who: Name = ""


HowAsked: TypeAlias = Literal["kept", "given", "unanswered", "withdrawn"]


class AskEnded(ControlMessageBase, frozen=True):
    """Either side: a question for the arming of a route is over. The asker's side disarms it, then arms it.

    Attributes:
        number: of the question.
        how: the holder keeps or gives it, as the holder's side says, or has not answered in time; or the operator who
            asked is gone, as that one's side says.
        own: whether an operator of the side that sends this had asked.
    """

    route: RouteId
    number: Count
    how: HowAsked
    own: bool = False


HolderMessage: TypeAlias = AskForArming | AskEnded


class ByHand(ControlMessageBase, frozen=True):
    """Either side: an operator there makes a call by hand. The message only reports it.

    Attributes:
        request: what the operator wrote, or the beginning of it, on one line.
        outcome: the call's result in words, or empty before the call.
    """

    route: RouteId
    lane: Count = 0
    request: Reason = ""
    who: Name = ""
    outcome: Reason = ""


MOST_RECEIPTS = 500
"""Entries of each list in one message."""
_Counts: TypeAlias = Annotated[tuple[tuple[Count, Count], ...], Meta(max_length=MOST_RECEIPTS)]


class Receipts(ControlMessageBase, frozen=True, omit_defaults=True):
    """Receipts for data streams, from either side. An entry for a stream that is over is ignored.

    Attributes:
        received: numbers of streams with the bytes that the sender of the message has received on them.
        every: numbers of streams with the bytes after which the sender of the message wants a receipt.
        given_up: numbers of streams that are over at the sender of the message, as nothing gets through.
    """

    received: _Counts = ()
    every: _Counts = ()
    given_up: Annotated[tuple[Count, ...], Meta(max_length=MOST_RECEIPTS)] = ()


class NamePattern(msgspec.Struct, frozen=True, omit_defaults=True):
    """A pattern of wanted names.

    Attributes:
        pattern: of names on the asked side (`rsb_bridge.model.patterns`); an invalid one matches nothing.
        kind: the kind of the named entries; an unknown kind is a newer peer's, and ignored.
    """

    pattern: Name
    kind: Name = "topic"


class FoundName(msgspec.Struct, frozen=True, omit_defaults=True):
    """A name that matches.

    Attributes:
        type: empty where its endpoints disagree, or it has none.
        kind: what it is; another one is a newer peer's.
    """

    name: Name
    type: Name = ""
    kind: Name = "topic"


Patterns: TypeAlias = Annotated[tuple[NamePattern, ...], Meta(max_length=PATTERNS_PER_LINK)]
Names: TypeAlias = Annotated[tuple[FoundName, ...], Meta(max_length=NAMES_FOLLOWED)]


class Follow(ControlMessageBase, frozen=True):
    """Either side asks for reports of matching names in the peer's graph, from now on. Replaces an earlier `Follow`.

    Attributes:
        patterns: the wanted names; without any, reports end.
    """

    request: Count
    patterns: Patterns = ()


class Followed(ControlMessageBase, frozen=True):
    """Changes since the last answer to a `Follow`; the first answer has all matches, and may have none.

    Attributes:
        request: the `Follow`'s.
        present: new matches, and matches of another type than before.
        more: number of further matches that the message leaves out.
    """

    request: Count
    present: Names = ()
    gone: Names = ()
    more: Count = 0


class Lease(ControlMessageBase, frozen=True):
    """A number from either side, sent several times a second while a route is armed or an operator asks for that.

    Attributes:
        number: of this message among its sender's, counting up.
        echo: the newest number that its sender has heard from the other side, or 0 before the first.
    """

    number: LeaseNumber
    echo: LeaseNumber = 0


class Settled(ControlMessageBase, frozen=True):
    """The answer to `Disarm`: the sender publishes nothing of that opening any more."""

    route: RouteId


LeaseMessage: TypeAlias = Lease | Settled
UrgentMessage: TypeAlias = Lease | Disarm
"""The messages that may cross as datagrams besides. Each may come twice, late, or before those sent earlier."""
ControlMessage: TypeAlias = (
    Propose
    | Accept
    | Refuse
    | Describe
    | Ready
    | Publishers
    | Provide
    | ByHand
    | Neighbours
    | Close
    | Amend
    | Edit
    | EditAnswer
    | Limit
    | Pause
    | Arm
    | Armed
    | Disarm
    | AskForArming
    | AskEnded
    | Settled
    | Lease
    | Ping
    | Pong
    | Report
    | Receipts
    | ListTopics
    | TopicList
    | AskType
    | TypeText
    | Follow
    | Followed
    | Duplicate
    | Shutdown
)
