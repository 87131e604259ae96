"""The control messages, typed (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.model.lanes import MOST_LANES
from rsb_bridge.model.qos import Qos  # noqa: TC001 - msgspec resolves the annotation at run time
from rsb_bridge.model.sources import MOST_SOURCES
from rsb_bridge.wire.amending import Amend, Limit, Pause
from rsb_bridge.wire.arming import Arm, Armed, Disarm, check_deadman
from rsb_bridge.wire.benchmark import BenchAnswer, BenchAsk
from rsb_bridge.wire.by_hand import ByHand
from rsb_bridge.wire.fields import (
    Bridges,
    Compression,
    Count,
    Features,
    Hertz,
    LateAfter,
    LinkId,
    MaxAge,
    MaybeHops,
    Name,
    Nanoseconds,
    NewestNumbers,
    NodeNames,
    Port,
    PublisherIds,
    Rank,
    Reason,
    RefuseCode,
    RouteId,
    Seconds,
    Shift,
    StaleAfter,
    Transport,
    check_limits,
    check_max_age,
)
from rsb_bridge.wire.following import Follow, Followed
from rsb_bridge.wire.lease import Lease, Settled
from rsb_bridge.wire.message import ControlMessageBase as _Message
from rsb_bridge.wire.questions import AskType, ListTopics, TopicList, TypeText
from rsb_bridge.wire.receipts import Receipts
from rsb_bridge.wire.records import (
    CallsReport,
    FullRecord,
    LaneEntry,
    ReceivedReport,
    SentReport,
    Source,
    check_qos,
)


class Hello(_Message, frozen=True):
    """The client, in the handshake.

    Attributes:
        version: of its software.
        name: of its session; the same as in the preamble.
        instance: random, new with each start of the process.
        domain_id: its ROS domain.
        features: what it can do beyond version 2, as `rsb_bridge.model.lanes.FEATURE`; others are a newer peer's.
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
        features: as in `Hello`.
        use_name: it puts the client's name before the names of this client's topics.
        taken: who has the client's name, for an operator: the client confirms, and is refused; empty: nobody.
        shut_down: who has shut the link down, for an operator: likewise.
        at: its address in a Zenoh network, or empty. A client that reached it at another one was led there by somebody.
    """

    version: Name
    name: Name
    link_id: LinkId
    instance: Name
    domain_id: Count
    features: Features = ()
    use_name: bool = False
    taken: Reason = ""
    shut_down: Reason = ""
    at: Name = ""


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
        late_after: s, 0 for no limit, or None for each side's own default.
        max_age: s that a message may be old when it is published, 0 for no limit, or None if the proposer's session
            sets none.
        paused: begin paused.
        pause_revision: of `paused`; see `Pause`.
        arm: the proposer's session wants it to be armed before anything crosses.
        deadman: s without a key after which it disarms; 0: none.
        who: the operator who has just added or edited the topic, in words; empty: none has, or it is not known.
        edited: it takes the place of the route that was removed right before.
        kind: what it is, a key of `rsb_bridge.model.lanes.LANES`; another one is a newer peer's, and refused. Of what
            is not a topic, the "sending side" is the callers'. Only topics are proposed to a peer whose `features` lack
            `rsb_bridge.model.lanes.FEATURE`.
        timeout: s until a call without an answer is given up; 0: 30 s, or it is a topic.
        priority: of a topic, `rsb_bridge.model.priority.RANKS`; an older sender ignores it.
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
    arm: bool = False
    deadman: Seconds = 0.0
    who: Name = ""
    edited: bool = False
    kind: Name = "topic"
    timeout: Seconds = 0.0
    priority: Rank = 0
    late_after: LateAfter | None = None
    max_age: MaxAge | None = None

    def __post_init__(self) -> None:
        check_qos(self.qos, depth_known=True)
        check_limits(self.max_rate, self.expected_rate, self.stale_after, self.late_after, self.max_age)
        check_deadman(self.deadman)


class Accept(_Message, frozen=True):
    """A `Propose` is accepted.

    Attributes:
        route: route id.
        topic: its name on the acceptor's side, which may add a prefix to the proposed one.
        arm: the acceptor wants it to be armed before anything crosses, be it by its session or by the proposal.
        deadman: as in `Propose`.
        max_age: as in `Propose`, by the acceptor's session.
    """

    route: RouteId
    topic: Name
    arm: bool = False
    deadman: Seconds = 0.0
    max_age: MaxAge | None = None

    def __post_init__(self) -> None:
        check_deadman(self.deadman)
        check_max_age(self.max_age)


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
    newest: NewestNumbers = msgspec.field(default_factory=dict)


class Publishers(_Message, frozen=True):
    """The sending side of a latched topic: which publishers are there; after each `Ready`, and when they change.

    Attributes:
        route: which.
        present: their ids. The histories of others may be dropped after a while.
    """

    route: RouteId
    present: PublisherIds


class Provide(_Message, frozen=True):
    """The providing side of what is called: what there is to call; after `Accept`, and whenever that changes.

    Attributes:
        route: route id.
        lanes: in the order of the kind (`rsb_bridge.model.lanes`); empty: nothing can be called now.
        nodes: that provide it, some of them.
        via: of a provider that is a bridge itself, the hops between it and the node that answers (section 5).
        pause_revision: of the state of the pause that its sender had; see `Pause`.
    """

    route: RouteId
    lanes: Annotated[tuple[LaneEntry, ...], Meta(max_length=MOST_LANES)] = ()
    nodes: NodeNames = ()
    via: MaybeHops = ()
    pause_revision: Count = 0


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
        who: the operator who has removed it, in words; empty: as in `Propose`, or it is edited.
    """

    route: RouteId
    reason: Reason
    removed: bool = False
    who: Name = ""


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
        shift: ns, to be added to the answerer's times; the sums are of a clock that nobody sets, as are the stamps of
            its messages to a peer with the feature `max_age`.
    """

    n: Count
    sent: Nanoseconds
    received: Nanoseconds
    answered: Nanoseconds
    shift: Shift = 0


class Report(_Message, frozen=True):
    """Either side: its counts, once a second.

    Attributes:
        sent: of the routes that it sends on.
        received: of those that it receives on.
        calls: of those that carry calls, either way.
        full: the rates of a full link in the direction of the message, or None if unchanged.
    """

    sent: tuple[SentReport, ...]
    received: tuple[ReceivedReport, ...]
    calls: tuple[CallsReport, ...] = ()
    full: FullRecord | None = None


class Duplicate(_Message, frozen=True):
    """The server: a second client has the name and the key of this one, and is refused.

    Attributes:
        address: where it is; empty: it does not try any more.
        host: what its machine calls itself; or empty.
        others: how many more of them there are, as far as the server counts.
    """

    address: Name = ""
    host: Name = ""
    others: Count = 0


class Shutdown(_Message, frozen=True):
    """Either side: this link ends on purpose.

    Attributes:
        reason: why, for an operator.
        retry_after: s until the client may call again; None: an operator has shut the link down.
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
    | Provide
    | ByHand
    | Neighbours
    | Close
    | Amend
    | Limit
    | Pause
    | Arm
    | Armed
    | Disarm
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
    | BenchAsk
    | BenchAnswer
    | Duplicate
    | Shutdown
)
