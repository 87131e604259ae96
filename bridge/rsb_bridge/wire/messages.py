"""The control messages, typed (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.calls import MOST_LANES
from rsb_bridge.model.hops import MOST_SOURCES
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.patterns import NAMES_FOLLOWED, PATTERNS_PER_LINK
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.transport_traits import Compression
from rsb_bridge.model.transports import Protocol
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.headers import LeaseNumber
from rsb_bridge.wire.records import (
    AssociationId,
    Bridges,
    CallsReport,
    Count,
    DescriptionText,
    FeatureNames,
    FeatureValues,
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
    ReceivedCounts,
    ReceivedReport,
    RefuseCode,
    RouteId,
    Seconds,
    SentCounts,
    SentReport,
    Shift,
    Source,
    check_limits,
    check_qos,
)


class ControlMessageBase(msgspec.Struct, frozen=True, tag_field="message", tag=str.lower):
    """One control message: a msgpack map whose `message` is the type's name in lower case."""


class ConnectionMessage(ControlMessageBase, frozen=True):
    """A message that means nothing on another connection than its own, or that is asked for or sent again there."""


class Hello(ControlMessageBase, frozen=True):
    """The client, in the handshake."""

    version: Name
    name: Name  # of its session; the same as in the preamble
    instance: Name  # random, new with each start of the process
    domain_id: Count
    host: Name = ""  # its machine's host name, for operators, or empty if unknown
    features: FeatureNames = ()  # the names of its features (`rsb_bridge.feature`); only what both sides have is used
    association: AssociationId = b""  # that it resumes, or empty for a new one
    handled: Count = 0  # control messages of that association that it has handled
    outlive: Seconds = 0.0  # s that its side of an association outlives a connection, or 0 if it does not


class Welcome(ControlMessageBase, frozen=True):
    """The server, in the handshake."""

    version: Name
    name: Name
    link_id: LinkId  # 8 random bytes that name this link
    instance: Name  # random, new with each start of the process
    domain_id: Count
    use_name: bool = False  # whether it puts the client's name before the names of this client's topics
    taken: Reason = ""  # text on the client that has the name already, or empty. This client confirms, and is refused
    shut_down: Reason = ""
    """Text on the operator who has shut the link down, or empty. The client confirms, and is refused."""
    at: Name = ""  # its address in a Zenoh network, or empty. A client that reached it at another address was misled
    features: FeatureNames = ()  # as in `Hello`
    association: AssociationId = b""  # the client's, if this side resumes it, too
    handled: Count = 0  # as in `Hello`
    outlive: Seconds = 0.0  # as in `Hello`


class Propose(ControlMessageBase, frozen=True, kw_only=True):
    """Either side: bridge this topic. Answered by `Accept` or `Refuse`."""

    route: RouteId  # its id from now on; a client's are odd, a server's even, and none is used twice in a link's life
    topic: Name  # its name on the sending side
    remote_topic: Name  # its name on the receiving side
    from_client: bool  # whether the client sends; else the server does
    type: Name = ""  # ``pkg/msg/Name``, or empty for the type in either side's graph
    transport: Protocol = "tcp"
    port: Port = 0  # the port of its own socket, or 0 for the shared one
    qos: Qos | None = None  # the QoS, or None for the publishers' offer
    compression: Compression = "none"  # the sender's, for each message
    max_rate: Hertz = 0.0  # Hz, or 0 for no limit
    expected_rate: Hertz = 0.0  # Hz, shown to operators, or 0 if each side learns it
    stale_after: Seconds | None = None  # s, 0 to never warn, or None for each side's own default
    paused: bool = False
    pause_revision: Count = 0  # of `paused`; see `Pause`
    arm: bool = False  # whether the proposer's session requires arming before anything crosses
    deadman: Seconds = 0.0  # s without a key after which it disarms, or 0 for none
    who: Name = ""  # the operator who has just added or edited the topic, or empty if unknown
    place: Name = ""  # where the proposer's session lists it, for operators: ``topics[2] of robot1.yaml``
    by_pattern: bool = False  # whether a pattern of the proposer's has made it. An entry that names it goes before it
    kind: Name = "topic"
    """A key of `rsb_bridge.model.calls.LANES`; another kind is a newer peer's, and refused. For calls, the "sending
    side" is the callers'."""
    timeout: Seconds = 0.0  # s until a call without an answer is given up, or 0 for 30 s and for topics
    priority: Rank = 0  # of a topic, `rsb_bridge.model.session.RANKS`
    late_after: Seconds | None = None  # s, 0 for no limit, or None for each side's own default
    max_age: Seconds | None = None
    """s that a message may be old when it is published, 0 for no limit, or None if the proposer's session sets none."""
    on_end: Name = ""
    """The message that the receiving side publishes once an arming ends, by the proposer's session: ``zero``, ``none``,
    the JSON of its fields, or empty if the session says nothing."""
    limits: VelocityLimits | None = None  # what a hand may ask, by the proposer's session, or None for any velocity
    keep: Keep | None = None  # all messages of some time wait for the link, or None for what the QoS keeps
    beat: Name = ""  # what topics share of which the sending side lets messages of one stamp pass together, or empty
    lazy: bool | None = None
    """Whether the sending side subscribes only while somebody on the other side does, or None by its own profile."""
    renew: bool = False  # whether the sending side subscribes anew when more subscribe on the other one
    express: bool = False  # whether the sending side sends its messages at once
    purpose: Name = "topic"
    """A name of `rsb_bridge.model.purposes.purposes`; another one is a newer peer's, and refused."""
    features: FeatureValues = {}
    """Values of the features' keys that are for the peer, too, by name. It takes those of features that it has."""

    def __post_init__(self) -> None:
        check_qos(self.qos, depth_known=True)
        check_limits(self)


class Accept(ControlMessageBase, frozen=True):
    """A `Propose` is accepted. The demands on an arming are as there, by the acceptor's session."""

    route: RouteId
    topic: Name  # its name on the acceptor's side, which may add a prefix to the proposed one
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
    """The sending side describes the messages that it will send."""

    route: RouteId
    type: Name
    type_hash: Name  # ``RIHS01_...``; may be empty
    qos: Qos
    """The QoS to publish with. A depth of 0 means as the messages themselves say (`rsb_bridge.wire.headers`), or as the
    receiver likes."""
    sources: Annotated[tuple[Source, ...], Meta(min_length=1, max_length=MOST_SOURCES)]
    """Each gets a publisher, by its number. Described again, there may be more of them, never fewer."""
    keyed: bool = False
    """Whether the type has a key, as the kind of a publisher tells: only a side that has the type can publish it."""
    nodes: NodeNames = ()  # some of the nodes that publish the topic

    def __post_init__(self) -> None:
        check_qos(self.qos)


class Ready(ControlMessageBase, frozen=True):
    """The receiving side has publishers, and the sending side may send. Answers each `Describe`."""

    route: RouteId
    sources: Count  # there are publishers for the first so many of them
    before: ReceivedCounts | None = None
    """Counts of the last incarnation in which anything came from this process of the peer; its route id names that
    incarnation."""
    newest: NewestNumbers = msgspec.field(default_factory=dict)
    """The number of the newest message published here, of each publisher of a latched topic on the sending side."""
    resends: Nanoseconds = 0  # as the last `Publishers` said, which a new process of the sending side does not know


class Publishers(ControlMessageBase, frozen=True):
    """The sending side's publishers, if they are latched or have a lease; after each `Ready`, and when they change."""

    route: RouteId
    present: HistoryDepths
    """The messages that each latched one keeps for late joiners, by its id, or 0 while that is unknown. The histories
    of others may be dropped after a while."""
    alive: bool = False
    """Whether one of them is alive, by its liveliness lease: then the receiving side asserts its own."""
    resends: Nanoseconds = 0  # when the newest message was published if it will be sent again, or 0


class Provide(ControlMessageBase, frozen=True):
    """The providing side of a route of calls: its providers; after `Accept`, and whenever they change."""

    route: RouteId
    lanes: Annotated[tuple[LaneEntry, ...], Meta(max_length=MOST_LANES)] = ()
    """The lanes in the order of the kind (`rsb_bridge.model.calls`), or empty if nothing can be called now."""
    nodes: NodeNames = ()  # some of the providing nodes
    via: MaybeHops = ()  # if the provider is a bridge itself, the hops between it and the answering node (section 5)
    pause_revision: Count = 0  # the revision of the sender's pause; see `Pause`


class Neighbours(ControlMessageBase, frozen=True):
    """Either side, before anything else and again when it changes: which bridges are in its domain."""

    bridges: Bridges  # the names of their nodes, its own first


class Close(ControlMessageBase, frozen=True):
    """Either side: the route ends."""

    route: RouteId
    reason: Reason
    code: EndCode = EndCode.DECIDED  # whether it is removed, or edited, or its data connection has ended, and how
    who: Name = ""  # the operator who has removed it, or empty if unknown


class Ping(ConnectionMessage, frozen=True):
    """A question of either side: whether the peer is alive, and its time."""

    n: Count
    sent: Nanoseconds  # ns since the epoch on the sender's clock
    handled: Count = 0
    """Control messages of this association that the sender has handled, without each `ConnectionMessage`."""


class Pong(ConnectionMessage, frozen=True):
    """The answer to a `Ping`: the first three of an exchange's four times (RFC 5905, section 8)."""

    n: Count
    sent: Nanoseconds
    received: Nanoseconds  # ns since the epoch on the answerer's clock, when the ping came
    answered: Nanoseconds  # ns since the epoch on the answerer's clock, when this was sent
    shift: Shift = 0
    """ns to add to the answerer's times. The sums follow a clock that is never set, as do the stamps of its
    messages."""


class Report(ConnectionMessage, frozen=True):
    """Either side: what has changed of its routes, once a second."""

    sent: tuple[SentReport, ...] = ()  # of the routes that it sends on
    received: tuple[ReceivedReport, ...] = ()  # of the routes that it receives on
    calls: tuple[CallsReport, ...] = ()  # of the routes of calls, in both directions
    sent_counts: tuple[SentCounts, ...] = ()  # of the routes that it sends on
    received_counts: tuple[ReceivedCounts, ...] = ()  # of the routes that it receives on
    full: FullRecord | None = None  # the rates of a full link in the direction of the message, or None if unchanged
    path: PathRecord | None = None  # what the path loses in the direction of the message, or None if unchanged
    looked_at: bool | None = None  # whether anybody looks at the figures all the time, or None if unchanged


class Duplicate(ConnectionMessage, frozen=True):
    """The server: a second client has the name and the key of this one, and is refused."""

    address: Name = ""  # the second client's, or empty once it no longer tries
    host: Name = ""  # its machine's host name, or empty
    others: Count = 0  # number of further such clients, as far as the server counts


class Shutdown(ConnectionMessage, frozen=True):
    """Either side: this link ends on purpose."""

    reason: Reason
    retry_after: Seconds | None = 0.0
    """s until the client may call again, or None if an operator has shut the link down."""


class ListTopics(ConnectionMessage, frozen=True):
    """Either side asks for the topics, services and the like of the peer's graph.

    Answered by a `TopicList` with the same request number.
    """

    request: Count


class TopicList(ConnectionMessage, frozen=True):
    """The answer to `ListTopics`."""

    request: Count
    topics: Annotated[bytes, Meta(max_length=CONTROL_LIMIT)]  # the entries (`rsb_bridge.wire.codec.pack_topics`)


class AskType(ConnectionMessage, frozen=True):
    """Either side asks for the descriptions of a route's types. Answered by a `TypeText`."""

    route: RouteId


class TypeText(ConnectionMessage, frozen=True):
    """The answer to `AskType`."""

    route: RouteId
    text: DescriptionText = b""
    """The descriptions (`rsb_bridge.cdr.description`), one a line, zstd-compressed, or empty if there are none."""


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
    keep: Keep | None = None
    beat: Name = ""
    lazy: bool | None = None
    renew: bool = False
    features: FeatureValues = {}

    def __post_init__(self) -> None:
        check_limits(self)


class Edit(ControlMessageBase, frozen=True, kw_only=True):
    """The side that did not propose a route asks its proposer to change the entry. Answered by `EditAnswer`."""

    number: Count  # of this question among its sender's
    route: RouteId  # the route's present or last opening
    seen: Propose  # a proposal of the entry as the sender sees it
    wanted: Propose
    """The same with changes. What differs is changed, except `arm`, `deadman`, `on_end` and `limits`, which each
    session demands for itself."""
    who: Name = ""  # the operator who edits it, or empty if unknown


class EditAnswer(ControlMessageBase, frozen=True):
    """The answer to `Edit`."""

    number: Count
    problem: Reason = ""  # the reason why the entry stays as it was, or empty if it was changed


class Limit(ControlMessageBase, frozen=True):
    """Either side: a limit of its own on the route's rate, in addition to the proposer's."""

    route: RouteId
    max_rate: Hertz = 0.0  # Hz, or 0 for no limit

    def __post_init__(self) -> None:
        check_limits(self)


class Pause(ControlMessageBase, frozen=True):
    """Either side: the route pauses or resumes."""

    route: RouteId
    paused: bool  # whether it pauses; else it resumes
    revision: Count
    """The change's number, above all numbers that its side had seen. The highest revision counts on both sides, and of
    two equal ones the client's."""
    who: Name = ""  # the operator who made the change, or empty if no longer known


class Arm(ControlMessageBase, frozen=True):
    """Either side: an operator arms the route, which the other side answers by `Armed`.

    Sent again, once a second at most, when that operator has pressed a key.
    """

    route: RouteId  # route id. Under one id a route is armed once
    who: Name = ""  # the operator, in words


class Armed(ControlMessageBase, frozen=True):
    """The answer to `Arm`: from now on both sides treat the route as armed."""

    route: RouteId


class Disarm(ControlMessageBase, frozen=True):
    """Either side: the route is not armed any more, or cannot be armed under this id. Its proposer opens it again."""

    route: RouteId
    cause: Name  # the reason's stable name
    who: Name = ""  # the operator who disarmed it, or empty if no operator did


ArmingMessage: TypeAlias = Arm | Armed | Disarm


class AskForArming(ControlMessageBase, frozen=True):
    """Either side: an operator asks the holder, an operator of either side, for the arming of a route."""

    route: RouteId
    number: Count  # of this question among its sender's
    who: Name = ""  # the operator who asks, in words


HowAsked: TypeAlias = Literal["kept", "given", "unanswered", "withdrawn"]


class AskEnded(ControlMessageBase, frozen=True):
    """Either side: a question for the arming of a route is over. The asker's side disarms it, then arms it."""

    route: RouteId
    number: Count  # of the question
    how: HowAsked
    """The holder keeps or gives it, as the holder's side says, or has not answered in time; or the operator who asked
    is gone, as that one's side says."""
    own: bool = False  # whether an operator of the side that sends this had asked


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


MOST_RECEIPTS = 500  # entries of each list in one message
_Counts: TypeAlias = Annotated[tuple[tuple[Count, Count], ...], Meta(max_length=MOST_RECEIPTS)]


class Receipts(ConnectionMessage, frozen=True, omit_defaults=True):
    """Receipts for data streams, from either side. An entry for a stream that is over is ignored."""

    received: _Counts = ()  # numbers of streams with the bytes that the sender of the message has received on them
    every: _Counts = ()  # numbers of streams with the bytes after which the sender of the message wants a receipt
    given_up: Annotated[tuple[Count, ...], Meta(max_length=MOST_RECEIPTS)] = ()
    """Numbers of streams that are over at the sender of the message, as nothing gets through."""


class NamePattern(msgspec.Struct, frozen=True, omit_defaults=True):
    """A pattern of wanted names."""

    pattern: Name  # of names on the asked side (`rsb_bridge.model.patterns`); an invalid one matches nothing
    kind: Name = "topic"  # the kind of the named entries; an unknown kind is a newer peer's, and ignored


class FoundName(msgspec.Struct, frozen=True, omit_defaults=True):
    """A name that matches."""

    name: Name
    type: Name = ""  # empty where its endpoints disagree, or it has none
    kind: Name = "topic"  # what it is; another one is a newer peer's


Patterns: TypeAlias = Annotated[tuple[NamePattern, ...], Meta(max_length=PATTERNS_PER_LINK)]
Names: TypeAlias = Annotated[tuple[FoundName, ...], Meta(max_length=NAMES_FOLLOWED)]


class Follow(ControlMessageBase, frozen=True):
    """Either side asks for reports of matching names in the peer's graph, from now on. Replaces an earlier `Follow`."""

    request: Count
    patterns: Patterns = ()  # the wanted names; without any, reports end


class Followed(ControlMessageBase, frozen=True):
    """Changes since the last answer to a `Follow`; the first answer has all matches, and may have none."""

    request: Count  # the `Follow`'s
    present: Names = ()  # new matches, and matches of another type than before
    gone: Names = ()
    more: Count = 0  # number of further matches that the message leaves out


class AskMeant(ConnectionMessage, frozen=True):
    """Either side asks for a name of the peer's graph that a pattern may mean. Answered by `MeantName`."""

    number: Count  # of this question among its sender's
    pattern: Name  # of names on the asked side; an invalid one means nothing
    kind: Name = "topic"  # of these names; nothing is of an unknown kind
    matching: bool = False  # whether a name that it matches is sought, or else a similar one only


class MeantName(ConnectionMessage, frozen=True):
    """The answer to `AskMeant`."""

    number: Count
    name: Name = ""  # that nodes publish or provide there, or empty


class Lease(ConnectionMessage, frozen=True):
    """A number from either side, sent several times a second while a route is armed or an operator asks for that."""

    number: LeaseNumber  # of this message among its sender's, counting up
    echo: LeaseNumber = 0  # the newest number that its sender has heard from the other side, or 0 before the first


class Settled(ControlMessageBase, frozen=True):
    """The answer to `Disarm`: the sender publishes nothing of that opening any more."""

    route: RouteId


class Unsaved(ControlMessageBase, frozen=True):
    """Whether the sender's file lacks a change that the receiver's operators have made to the sender's session."""

    unsaved: bool


LeaseMessage: TypeAlias = Lease | Settled
UrgentMessage: TypeAlias = Lease | Disarm
"""The messages that may cross as datagrams besides. Each may come twice, late, or before those sent earlier."""
ControlMessage: TypeAlias = (
    Propose | Accept | Refuse | Describe | Ready | Publishers | Provide | ByHand | Neighbours | Close | Amend | Edit
    | EditAnswer | Limit | Pause | Arm | Armed | Disarm | AskForArming | AskEnded | Settled | Lease | Ping | Pong
    | Report | Receipts | ListTopics | TopicList | AskType | TypeText | Follow | Followed | AskMeant | MeantName
    | Duplicate | Shutdown | Unsaved
)  # fmt: skip
