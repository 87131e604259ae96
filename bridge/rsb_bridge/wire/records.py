"""The types of control messages' fields, each with its bounds, and the maps and lists in these (PROTOCOL.md, 3).

Text goes to terminals and logs, so it is short and has printable characters only. The counts and figures in reports
have no range here: an impossible figure must not end a link, so the receiver limits it (`rsb_bridge.route.ledger`).
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT
from rsb_bridge.model.hops import HOP_LENGTH, MOST_BRIDGES, MOST_HOPS
from rsb_bridge.model.limits import FEATURE_VALUES, LATCHED_DEPTH, PORT, RATE, REASON_LENGTH, TEXT_LENGTH
from rsb_bridge.model.qos import Qos, qos_problem
from rsb_bridge.model.session import HIGHEST, LOWEST
from rsb_bridge.model.text import UNPRINTABLE
from rsb_bridge.model.topic_keys import CORE_KEYS
from rsb_bridge.model.wording import Wording

PRINTABLE = rf"\A[^{UNPRINTABLE}]*\Z"  # not `$`, which also matches before an end of line

Name: TypeAlias = Annotated[str, Meta(max_length=TEXT_LENGTH, pattern=PRINTABLE)]
Reason: TypeAlias = Annotated[str, Meta(max_length=REASON_LENGTH, pattern=PRINTABLE)]

RouteId: TypeAlias = Annotated[int, Meta(ge=1, le=2**32 - 1)]
DescriptionText: TypeAlias = Annotated[bytes, Meta(max_length=DESCRIPTION_LIMIT)]
PublisherId: TypeAlias = Annotated[bytes, Meta(min_length=16, max_length=16)]
MessageNumber: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
HistoryDepth: TypeAlias = Annotated[int, Meta(ge=0, le=LATCHED_DEPTH)]
LinkId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]
AssociationId: TypeAlias = Annotated[bytes, Meta(max_length=8)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Shift: TypeAlias = Annotated[int, Meta(ge=-(2**62), le=2**62)]
Port: TypeAlias = Annotated[int, Meta(ge=0, le=int(PORT.high))]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
Hertz: TypeAlias = Annotated[float, Meta(ge=0, le=RATE.high)]
Causes: TypeAlias = Annotated[dict[Name, int], Meta(max_length=32)]
Rank: TypeAlias = Annotated[int, Meta(ge=LOWEST, le=HIGHEST)]
Hop: TypeAlias = Annotated[str, Meta(min_length=1, max_length=HOP_LENGTH, pattern=PRINTABLE)]
Hops: TypeAlias = Annotated[tuple[Hop, ...], Meta(min_length=1, max_length=MOST_HOPS)]
MaybeHops: TypeAlias = Annotated[tuple[Hop, ...], Meta(max_length=MOST_HOPS)]
Bridges: TypeAlias = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=MOST_BRIDGES)]
FeatureNames: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=64)]
FeatureValues: TypeAlias = Annotated[dict[Name, bool | float | Name], Meta(max_length=FEATURE_VALUES)]
NodeNames: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=16)]

MOST_PUBLISHERS = 4096  # of one latched topic, in one message
HistoryDepths: TypeAlias = Annotated[dict[PublisherId, HistoryDepth], Meta(max_length=MOST_PUBLISHERS)]
NewestNumbers: TypeAlias = Annotated[dict[PublisherId, MessageNumber], Meta(max_length=MOST_PUBLISHERS)]

RefuseCode = Literal["type_differs", "denied", "port_taken", "listed_too", "listed_differently"]


class Source(msgspec.Struct, frozen=True, omit_defaults=True):
    """The messages of a route that crossed the same bridges; the receiving side publishes them apart from others."""

    via: Hops
    """The bridges that they have crossed when they arrive, the first one first, the sending side last. Of each, its
    node's name and the topic that it took them from: ``_rsb_robot1_1a2b3c4d/scan``."""
    live: bool = True  # False: for now none of its messages will come


class VerdictRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """A side's verdict on a route that is not simply fine (`rsb_bridge.model.verdict.Verdict`)."""

    state: Name  # one of `rsb_bridge.model.snapshot.State`; another one is a newer peer's
    cause: Name = ""  # one of `rsb_bridge.model.verdict.Cause` or a newer peer's, or empty
    text: Reason = ""  # for an operator, with the remedy; ``{lasting}`` is a placeholder for its duration
    lasting: float = 0.0  # its duration so far, s. It is sent with other news only: the receiver counts on


class DriverRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """A publisher of what moves a robot (`rsb_bridge.model.snapshot.Driver`)."""

    name: Name = ""
    rate: float | None = None  # Hz that the sender takes of it, or None if nobody counts
    by_hand: bool = False


Drivers: TypeAlias = Annotated[tuple[DriverRecord, ...], Meta(max_length=16)]


class SentCounts(msgspec.Struct, frozen=True, array_like=True):
    """The sender's ledger of a route (`rsb_bridge.model.snapshot.Ledger`): a list, as it is sent once a second."""

    route: RouteId
    offered: int = 0  # messages taken from ROS since the route was made, as for all counts here
    delivered: int = 0  # published by the receiver, according to its last report
    in_flight: int = 0
    waiting: int = 0
    waited: float = 0.0  # s, the age of the oldest message in the queue, or 0 without any
    dropped: Causes = {}  # by cause; msgspec makes a new one for each message
    throttled: int = 0  # left out because of `Propose.max_rate`
    expired: int = 0  # datagram messages that the receiver gave up incomplete
    unknown: int = 0  # sent to a process that ended before it reported whether they arrived
    lost_in_dds: int = 0  # lost before the subscribed bridge could take them
    missed_while_down: int = 0  # published while the route was closed
    unsubscribed: int = 0  # published before this side subscribed first, or while the topic was not to cross
    again: int = 0  # of `offered`, messages of a latched topic that were offered before


class SentReport(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The sender's knowledge of a route, beside its counts."""

    route: RouteId
    publishers: int = 0
    publisher_qos: Qos | None = None  # their combined offer, or None without publishers
    subscribed: bool = False  # whether the sender takes messages from ROS
    verdict: VerdictRecord | None = None
    nodes: NodeNames = ()  # some of the nodes that publish the topic
    drivers: Drivers = ()  # if it moves a robot, its publishers

    def __post_init__(self) -> None:
        check_qos(self.publisher_qos)


class DeafRecord(msgspec.Struct, frozen=True):
    """A subscription that does not hear the receiving side's publishers (`rsb_bridge.model.audience.Deaf`)."""

    node: Name
    cause: Name
    reason: Reason


DeafNodes: TypeAlias = Annotated[tuple[DeafRecord, ...], Meta(max_length=16)]


class ReceivedCounts(msgspec.Struct, frozen=True, array_like=True):
    """The receiving side's figures of one incarnation of a route: a list, as it is sent once a second or more often."""

    route: RouteId  # route id, which names the incarnation
    received: int = 0  # whole messages that arrived
    delivered: int = 0
    newest: int = 0  # the highest message number seen on datagrams; on streams, the messages that came or were lost
    latency: float | None = None
    """s, one way, of the last second's messages, corrected by the clock offset, or None without a figure."""
    latency_p50: float | None = None  # s, one way, of the last messages, or None without a figure
    latency_p99: float | None = None  # s, one way, of the last messages, or None without a figure
    jitter: float | None = None  # s (RFC 3550, 6.4.1), or None without a figure
    dropped: Causes = {}
    expired: int = 0  # datagram messages given up incomplete
    incomplete: int = 0  # datagram messages that wait for fragments
    velocity: tuple[float, float] | None = None
    """The velocity that this side has published last on an armed topic: forward in m/s, and turn in rad/s, or None."""


class ReceivedReport(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The receiving side's knowledge of one incarnation of a route, beside its figures."""

    route: RouteId  # route id, which names the incarnation
    subscribers: int = 0  # subscriptions that DDS has matched
    subscriber_qos: Qos | None = None  # the combined request of all subscriptions, or None without any
    type: Name = ""
    """The topic's type in the receiver's graph; once the sender has described one, of the subscriptions there."""
    type_hash: Name = ""
    verdict: VerdictRecord | None = None
    wanted: bool = False  # whether this bridge itself takes them: for another link, an operator or a recording
    nodes: NodeNames = ()  # some of the nodes that hear the topic
    deaf: DeafNodes = ()  # some of the other subscriptions
    publishers: NodeNames = ()  # some of the nodes that publish the topic here, while the sending side has no publisher
    published_as: Name = ""  # the similar name under which `publishers` do, or empty if it is the topic's own
    came_before: bool = False  # whether messages came in an earlier incarnation, and none in this one
    malformed: Reason = ""  # the field of the last malformed message, and what is wrong with it, or empty
    drivers: Drivers = ()  # if the topic moves a robot, its publishers beside this link

    def __post_init__(self) -> None:
        check_qos(self.subscriber_qos)


class FullRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """Rates of a full link in the direction of the report (`rsb_bridge.model.capacity.Fullness`)."""

    carried: float = 0.0  # bytes/s that arrive
    asked: float = 0.0  # bytes/s that the sender's topics ask for, or 0 if the link is no longer full
    topics: NodeNames = ()  # names on the receiving side of the topics that ask for the most


class PathRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """Loss of packets in the direction of the report (`rsb_bridge.link.path_watch`)."""

    lost: Share | None = None  # share of the packets, 0 to 1, or None without a figure
    lossy: Share = 0.0  # the same, rounded, if it is a fault, else 0
    large: bool = False  # whether large packets are lost while small ones arrive


class LaneEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """One of the services or topics that a route of calls consists of."""

    type: Name  # ``pkg/srv/Name``, of a service that belongs to an action ``pkg/action/Name_SendGoal``, or a message's
    type_hash: Name = ""  # ``RIHS01_...``; of a service, its own, which covers request and response; may be empty
    providers: Count = 0  # number of nodes that serve or publish it


class CallsReport(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A side's report of a route of calls."""

    route: RouteId
    given: int = 0
    """The number of the newest call of this opening that the providing side gave to DDS, with all before it, or 0."""
    waiting: int = 0  # of the providing side, calls that wait until their node has read earlier ones
    offered: bool = False  # whether the callers' side offers it
    verdict: VerdictRecord | None = None
    nodes: NodeNames = ()  # some of the calling or providing nodes
    malformed_type: Name = ""  # of the last malformed request, response or message, or empty
    malformed: Reason = ""  # its field, and what is wrong with it, or empty


class TopicEntry(msgspec.Struct, frozen=True):
    """An entry of a side's graph: a topic, or an entry of another requested kind."""

    topic: Name
    type: Name  # empty if its endpoints disagree
    type_hash: Name  # or empty
    qos: Qos | None  # the publishers' offer, or None without publishers
    publishers: Count
    subscriptions: Count
    kind: Name = "topic"  # its kind; an unknown kind is a newer peer's

    def __post_init__(self) -> None:
        check_qos(self.qos)


def check_qos(qos: Qos | None, *, depth_known: bool = False) -> None:
    """Check the QoS in a message.

    Args:
        depth_known: whether a depth of 0, which means unknown, is out of range too.

    Raises:
        ValueError: a figure is out of range.
    """
    if qos is not None and (problem := qos_problem(qos, depth_known=depth_known)):
        raise ValueError(f"qos: {problem}")


class OrderOutcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """The end of an order.

    Attributes:
        refused: whether nothing was done.
        reason: why it is not done, for an operator, or empty.
        seconds: that it took.
    """

    refused: bool = False
    reason: Reason = ""
    seconds: Seconds = 0.0

    @property
    def done(self) -> bool:
        return not self.reason


class OutOfRange(Wording):
    RATE = "a rate is 0 or {range} Hz"
    PART = "{name} is {range} {unit}"
    SECONDS = "{name} is 0 or {range} s"


_CHECKED = tuple(
    (name, key.limits, OutOfRange.RATE if key.unit == "Hz" else OutOfRange.SECONDS)
    for name, key in CORE_KEYS.items()
    if key.limits is not None and name != "timeout"
)
"""Not `timeout`: one that is out of range is refused with the topic, and the link stays."""


def check_limits(message: msgspec.Struct) -> None:
    """Check the limits of a route in a message, which are 0 or in a range, those on velocities, and what is kept.

    Raises:
        ValueError: one is out of its range.
    """
    for name, limits, mistake in _CHECKED:
        value = getattr(message, name, None)
        if value and value not in limits:
            raise ValueError(mistake(name=name, range=limits))
    for parts in (getattr(message, "limits", None), getattr(message, "keep", None)):
        for name, _, allowed, unit in () if parts is None else parts.out_of_range:
            raise ValueError(OutOfRange.PART(name=name, range=allowed, unit=unit))
