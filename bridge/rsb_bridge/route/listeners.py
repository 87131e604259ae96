"""The subscriptions on the receiving side of a topic's route: who hears it, who cannot, and what they ask for."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.known_types import CLOCK
from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.demands import full_type
from rsb_bridge.model.motion import may_move
from rsb_bridge.model.names import is_bridge
from rsb_bridge.model.qos import clashes, match_subscriptions
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import Cause
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.announcements import BY_HAND
from rsb_bridge.ros.ros_graph import Sought, agreed_type, is_mistyped
from rsb_bridge.route.combined_verdict import NODE_LENGTH, NODES, node_names
from rsb_bridge.route.loop_filter import publishers_besides

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.source_publishers import SourcePublishers
    from rsb_bridge.route.topic_flow import TopicFlow

_ASKED_EVERY = 0.9
"""s until the graph is asked again who subscribes, where their number is the same: less than the second after which
`link.graph_watch` looks once more, when the graph has settled."""
_MATCHED_WITHIN = 2.0
"""s. A round figure: DDS matches a subscription that it lists within milliseconds."""
_NAMED_WITHIN = 60.0
"""s after which an endpoint without a node's name gets none any more. A round figure: it takes seconds at most."""
_REASON_LENGTH = 200
"""Characters for which a node is deaf: a report to the other side has room for hundreds of routes."""
OF_MANY = frozenset(
    {
        "action_msgs/msg/GoalStatusArray",
        "bond/msg/Status",
        "diagnostic_msgs/msg/DiagnosticArray",
        "rcl_interfaces/msg/Log",
        "rcl_interfaces/msg/ParameterEvent",
        "sensor_msgs/msg/JointState",
        "tf2_msgs/msg/TFMessage",
        "visualization_msgs/msg/Marker",
        "visualization_msgs/msg/MarkerArray",
    }
)
"""Types of topics that many nodes publish by design."""


DURABLE = "durability transient or persistent, which ROS does not have"


class DeafText(Wording):
    """Reasons why DDS does not match a subscription with a publisher."""

    TYPE = "its type is {asked}, and that of the messages {offered}: make them equal"
    QOS = "it asks for {asked}, offered is {offered}: change its QoS"
    UNMATCHED = "DDS does not match it: {why}"


class UnmatchedText(Wording):
    """Reasons why DDS does not match an endpoint whose type's name and QoS fit, with the remedy."""

    KEY = "its type has a key (@key), which the bridge's may lack: install its package here, or use a type without"
    REFUSED = "its data representation or its ownership differs: set XCDR1 and shared ownership"
    OTHER = "its partition, security or type definition differs: set them as in ROS nodes"


class Mismatch(NamedTuple):
    """A reason why a subscription does not hear a publisher.

    Attributes:
        cause: `Cause.TYPE_CONFLICT` or `Cause.QOS_INCOMPATIBLE`.
        offered: the publisher's type, or its policies that do not suffice.
        asked: the subscription's, in the same order.
    """

    cause: Cause
    offered: tuple[str, ...]
    asked: tuple[str, ...]


def mismatch(type_name: str, offered: Qos, subscription: Endpoint) -> Mismatch | None:
    """Return what keeps a subscription from hearing a publisher of a type and a QoS, or None if DDS matches them."""
    if subscription.type_name != type_name:
        return Mismatch(Cause.TYPE_CONFLICT, (type_name,), (subscription.type_name,))
    if subscription.is_durable:
        return Mismatch(Cause.QOS_INCOMPATIBLE, (offered.durability,), (DURABLE,))
    found = clashes(offered, subscription.qos)
    return Mismatch(Cause.QOS_INCOMPATIBLE, *zip(*found, strict=True)) if found else None


def why_unmatched(endpoints: Iterable[Endpoint], *, refused: bool) -> str:
    """Return the reason why DDS does not match endpoints with the bridge's, as far as it can be found, and the remedy.

    ROS shows neither partition, ownership, representation nor key. DDS refuses another ownership or representation as
    a policy, and tells nothing of another partition, key or type definition.

    Args:
        refused: whether DDS has refused one for a policy that ROS does not know.
    """
    if all(each.has_key for each in endpoints):
        return UnmatchedText.KEY()
    return UnmatchedText.REFUSED() if refused else UnmatchedText.OTHER()


def audience(
    type_name: str, offered: Qos, subscriptions: Iterable[Endpoint], count: int, *, refused: bool = False
) -> Audience:
    """Return who hears a publisher of a type and a QoS.

    Args:
        count: subscriptions that DDS has matched with it. DDS does not say which.
        refused: as of `why_unmatched`.
    """
    hearing: list[Endpoint] = []
    deaf: set[tuple[str, str, str]] = set()
    for each in subscriptions:
        node = sanitize_text(each.node, NODE_LENGTH)
        if (why := mismatch(type_name, offered, each)) is not None:
            text = DeafText.TYPE if why.cause is Cause.TYPE_CONFLICT else DeafText.QOS
            reason = text(asked=", ".join(why.asked), offered=", ".join(why.offered))
            deaf.add((node, why.cause.value, sanitize_text(reason, _REASON_LENGTH)))
        elif not count:
            deaf.add((node, Cause.NONE.value, DeafText.UNMATCHED(why=why_unmatched([each], refused=refused))))
        else:
            hearing.append(each)
    return Audience(count, node_names(hearing), tuple(Deaf(*each) for each in sorted(deaf)[:NODES]))


def no_subscriber(topic: str, domain: str | None, present: Collection[object] = ()) -> str:
    """Says that nobody hears a topic, whether somebody subscribes to it or not.

    Args:
        domain: this side's (`Context.domain`), or None if it is the other side's subscribers that do not hear it.
    """
    where = "there" if domain is None else f"in domain {domain}"
    return (
        f"nothing from the bridge reaches the subscribers of {topic} {where}"
        if present
        else f"nobody subscribes to {topic} {where}"
    )


class PublishedAs(NamedTuple):
    """The publishers of a topic on its receiving side.

    Attributes:
        nodes: some of their names.
        near: the similar name under which they do, or empty if it is the topic's own.
    """

    nodes: tuple[str, ...] = ()
    near: str = ""


class Listeners:
    """The subscriptions of one route's topic here.

    Attributes:
        offered: the QoS of the publishers here, or None if unknown.
        subscriber_qos: that all of them request together, or None without any.
        others: other publishers of the topic here, if a subscription does not match.
        clocks: if it is a clock, the nodes and links that publish it here besides this link.
        further: if its messages may move a robot, the publishers of the topic here besides this link's.
        published: who publishes it here, while the sending side has no publisher: its direction may be wrong.
            Nobody for what several nodes publish by design.
        refused: whether DDS refuses subscriptions for a policy that ROS does not know.
        type_before: that the publishers had before the present one, or empty.
        hint: the type and its hash that they have, each empty if unknown: a sender without publishers takes it.
    """

    def __init__(self, flow: TopicFlow, outputs: SourcePublishers) -> None:
        self._route, self._flow, self._outputs = flow.route, flow, outputs
        self.offered: Qos | None = None
        self.subscriber_qos: Qos | None = None
        self.others: Collection[Endpoint] = ()
        self.clocks: frozenset[str] = frozenset()
        self.further: tuple[Endpoint, ...] = ()
        self.hint = ("", "")
        self.type_before = ""
        self.refused = False
        self.published = PublishedAs()
        self._unmatched_since: float | None = None  # s, since when DDS lists subscriptions and matches none
        self._asked_at = float("-inf")
        self._nameless: dict[bytes, float] = {}  # subscriptions without a node's name, and since when (s)

    def _look_for_drivers(self) -> None:
        drivers = self._flow.drivers
        # Only then: it searches the graph.
        self.further = tuple(publishers_besides(self._route, self._route.remote_topic)) if drivers.are_watched else ()
        if self.further or drivers.here:
            drivers.look(self.further)

    @property
    def unmatched(self) -> bool:
        """Whether DDS has listed subscriptions for a while and matches none."""
        since = self._unmatched_since
        return since is not None and self._route.context.now() > since + _MATCHED_WITHIN

    @property
    def lacks_match(self) -> bool:
        """Whether DDS lists subscriptions and matched none at the last look."""
        return self._unmatched_since is not None

    @property
    def awaits_name(self) -> bool:
        """Whether a subscription has no node's name yet, and may still get one."""
        return any(not self.is_nameless(gid) for gid in self._nameless)

    def is_nameless(self, gid: bytes) -> bool:
        """Whether a subscription gets no node's name any more, so that nobody knows whose it is."""
        return self._route.context.now() >= self._nameless.get(gid, math.inf) + _NAMED_WITHIN

    def look_without_publisher(self) -> None:
        """Find the type that the subscriptions have, while nothing is published here, and who else drives."""
        ends, topic = self._route.ends, self._route.remote_topic
        self.hint = agreed_type([*ends.publishers(topic), *ends.subscriptions(topic)])
        if self._flow.drivers.are_watched or self.further:
            self._look_for_drivers()

    def look_for_publishers(self, *, sends: bool) -> None:
        """Find who publishes it here, or else a topic of its type whose name may be written for its own.

        Args:
            sends: whether the sending side has a publisher: then nothing is looked for.
        """
        route, (type_name, _) = self._route, self.hint
        moves = self._flow.drivers.are_watched or may_move(type_name, route.topic, route.remote_topic)
        if sends or moves or type_name in OF_MANY or not route.purpose.in_graph:
            self.published = PublishedAs()
        elif found := self._nodes_that_publish(route.remote_topic):
            self.published = PublishedAs(found)
        else:
            type_name = type_name or full_type(route.proposal.type)
            # Its next tick looks again, if nobody there has begun to publish it meanwhile.
            near = route.context.similar_topics.of(Sought(route.remote_topic, type_name), route.judge_again)
            if near and is_mistyped(route.remote_topic, near):
                found = self._nodes_that_publish(near, type_name)
            self.published = PublishedAs(found, near if found else "")

    def _nodes_that_publish(self, topic: str, type_name: str = "") -> tuple[str, ...]:
        """Name nodes besides bridges that publish a topic, with this type if it is known."""
        publishers = self._route.ends.publishers(topic)
        return node_names(each for each in publishers if type_name in ("", each.type_name) and not is_bridge(each.node))

    def look(self) -> None:
        """Find the subscriptions of what is published here, unless they are the same ones, most likely."""
        route, flow = self._route, self._flow
        matched, now = self._outputs.subscriber_count, route.context.now()
        if matched:
            self._unmatched_since = None
        if matched and matched == flow.audience.count and now - self._asked_at < _ASKED_EVERY:
            return  # to ask for them costs too much to do so at every change of the graph
        self._asked_at = now
        endpoints = flow.carried.endpoints = route.ends.subscriptions(route.remote_topic)
        if not endpoints:
            self._unmatched_since = None
        elif not matched and self._unmatched_since is None:
            self._unmatched_since = now
        self._nameless = {each.gid: self._nameless.get(each.gid, now) for each in endpoints if not each.node}
        # The sender's publishers may have left, and an operator there may publish by hand.
        self.hint = agreed_type(endpoints)
        self.subscriber_qos = match_subscriptions([each.qos for each in endpoints]) if endpoints else None
        self._look_for_drivers()
        if self.offered is None:
            return
        self.refused = self.unmatched and self._outputs.refuses
        flow.audience = audience(flow.carried.type_name, self.offered, endpoints, matched, refused=self.refused)
        # Only then: it searches the graph, and only a clash needs the result.
        clash = any(each.cause == Cause.QOS_INCOMPATIBLE for each in flow.audience.deaf)
        self.others = tuple(route.ends.publishers(route.remote_topic)) if clash else ()
        self.clocks = _further_clocks(route) if flow.carried.type_name == CLOCK else frozenset()


def _further_clocks(route: Route) -> frozenset[str]:
    """Return the nodes and the links that publish a route's clock here besides it."""
    found = set()
    for each in publishers_besides(route, route.remote_topic):
        own = route.context.announcements.own_of(each.gid)
        if own is None or own.link == BY_HAND:
            found |= {each.node} if each.type_name == CLOCK else set()
        elif own.origin.via and own.origin.live:
            found.add(f"link {own.link}")
    return frozenset(found)
