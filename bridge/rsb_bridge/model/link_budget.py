"""The cost of one more topic on a link and its effect on other topics, computed from a snapshot before it is added.

A `Capacity` has a source and an age: the rate that crossed while more waited, or the highest rate seen. A topic's load
is measured if some link of this engine already bridges it; otherwise it is the usual load of its type, and marked as
such.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

import msgspec

from rsb_bridge.model.capacity import Capacity, CapacitySource
from rsb_bridge.model.keep import KEEP_BUDGET
from rsb_bridge.model.session import rank_of, weight_of
from rsb_bridge.model.text import join_first
from rsb_bridge.model.verdict import about
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping

    from rsb_bridge.model.keep import Keep
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot

K = TypeVar("K", bound="Hashable")


class TopicDemand(NamedTuple):
    """The demand of one topic."""

    rank: int  # rank of its priority; higher ranks are served first
    bytes_per_second: float  # rate on the wire


def allot(capacity: float, wishes: Mapping[K, TopicDemand]) -> dict[K, float]:
    """Divide a link by the weights of priorities, as its scheduler does (weighted max-min fairness).

    A topic that wants less than its share gets all it wants, and the others share the rest.

    Returns:
        Bytes/s by topic, at most its demand.
    """
    shares: dict[K, float] = {}
    left, weights = max(0.0, capacity), sum(weight_of(wish.rank) for wish in wishes.values())
    # The smallest demand for its weight first: what it leaves goes to the others.
    for key, wish in sorted(wishes.items(), key=lambda item: item[1].bytes_per_second / weight_of(item[1].rank)):
        shares[key] = min(wish.bytes_per_second, left * weight_of(wish.rank) / weights)
        left -= shares[key]
        weights -= weight_of(wish.rank)
    return shares


PER_MESSAGE = 60
"""Approximate overhead of a message on the wire, in bytes: more than about 30 of a sealed frame, less than 82 of a
datagram with UDP and IPv4 (PROTOCOL.md, 1.5 and 2)."""
_SUFFERS = 0.97  # a topic suffers if it gets less than this share of its demand
_NAMED = 3

TYPICAL: Final[dict[str, tuple[float, int]]] = {
    "geometry_msgs/msg/PoseStamped": (10.0, 90),
    "geometry_msgs/msg/Twist": (20.0, 52),
    "geometry_msgs/msg/TwistStamped": (20.0, 80),
    "nav_msgs/msg/OccupancyGrid": (0.2, 150_000),
    "nav_msgs/msg/Odometry": (50.0, 730),
    "nav_msgs/msg/Path": (1.0, 20_000),
    "sensor_msgs/msg/BatteryState": (1.0, 200),
    "sensor_msgs/msg/CameraInfo": (30.0, 400),
    "sensor_msgs/msg/CompressedImage": (30.0, 60_000),
    "sensor_msgs/msg/Image": (30.0, 921_600),
    "sensor_msgs/msg/Imu": (100.0, 330),
    "sensor_msgs/msg/JointState": (50.0, 400),
    "sensor_msgs/msg/Joy": (20.0, 100),
    "sensor_msgs/msg/LaserScan": (10.0, 4_000),
    "sensor_msgs/msg/NavSatFix": (5.0, 150),
    "sensor_msgs/msg/PointCloud2": (10.0, 600_000),
    "std_msgs/msg/String": (1.0, 50),
    "tf2_msgs/msg/TFMessage": (50.0, 300),
    "visualization_msgs/msg/MarkerArray": (5.0, 10_000),
}
"""Usual rate (Hz) and message size (bytes) by type: an image is 640 × 480 in colour, a cloud one turn of a 16-line
lidar, a scan 500 ranges with their intensities, a map 380 × 380 cells."""


class LoadSource(StrEnum):
    """Source of a topic's load, the most reliable first."""

    GIVEN = "given"
    HERE = "here"
    """Measured on this topic, which some link already bridges."""
    ALIKE = "alike"
    """Measured on another topic of the same type."""
    TYPICAL = "typical"
    """The usual load of its type."""
    UNKNOWN = "unknown"


class LinkLoad(NamedTuple):
    """The load that a topic puts on a link."""

    rate: float
    size: float  # bytes of a message
    source: LoadSource
    like: str = ""  # the topic it was measured on, or an empty string if it was not measured

    @property
    def bytes_per_second(self) -> float:
        return self.rate * (self.size + PER_MESSAGE)


class Sufferer(NamedTuple):
    """A topic that would get less."""

    topic: str  # its name on this side
    before: float  # bytes/s that it gets now
    after: float  # bytes/s that it would get


class Cost(NamedTuple):
    """The cost of a topic on a link."""

    load: LinkLoad  # the topic's load; its source may be `LoadSource.UNKNOWN`
    used: float  # bytes/s that cross now in the same direction
    capacity: Capacity | None  # the link's capacity in that direction, or None if unknown
    gets: float  # bytes/s that the topic itself would get
    sufferers: tuple[Sufferer, ...] = ()  # topics that would get less
    keep: Keep | None = None  # what waits for the link

    @property
    def kept(self) -> float | None:
        """Bytes that wait for a link that is away for as long as the topic keeps them, or None if it keeps nothing."""
        return None if self.keep is None else self.keep.seconds * self.load.rate * self.load.size

    @property
    def over(self) -> float:
        """Bytes/s beyond the link's capacity, or 0 if the topic fits or the capacity is unknown."""
        if self.capacity is None:
            return 0.0
        return max(0.0, self.used + self.load.bytes_per_second - self.capacity.bytes_per_second)


def cost_of(
    now: Snapshot,
    link: str,
    topic: Topic,
    *,
    type_name: str = "",
    rate: float | None = None,
    size: float | None = None,
    replaces: str = "",
) -> Cost:
    """Compute the cost of adding a topic to a link.

    Args:
        now: snapshot of this side's engine.
        topic: as the client sees it; a topic, not a service or the like.
        type_name: type from the ROS graph, or empty to use the topic's own entry.
        rate: Hz given by the operator, or None to estimate it.
        size: bytes of a message given by the operator, or None to estimate it.
        replaces: key of the route that the topic replaces, or an empty string if it is new.
    """
    outgoing = (topic.direction == "transmit") == (now.role == "client")
    load = load_of(now, topic, type_name=type_name, rate=rate, size=size)
    at = next((each for each in now.links if each.name == link), None)
    capacity = None if at is None else at.capacity_out if outgoing else at.capacity_in
    routes = [
        route
        for route in now.routes
        if route.link == link and route.outgoing == outgoing and route.key != replaces and route.calls is None
    ]
    wishes: dict[str, TopicDemand] = {
        route.key: TopicDemand(rank_of(route.spec), route.bytes_per_second + PER_MESSAGE * route.rate)
        for route in routes
    }
    used = sum(wish.bytes_per_second for wish in wishes.values())
    if capacity is not None and capacity.source == CapacitySource.SEEN and capacity.bytes_per_second < used:
        capacity = msgspec.structs.replace(capacity, bytes_per_second=used)  # more than before crosses right now
    own = TopicDemand(rank_of(topic), load.bytes_per_second)
    if capacity is None or (
        # So little has crossed, as on a link that has just come up, that it tells nothing about this topic.
        capacity.source == CapacitySource.SEEN and capacity.bytes_per_second < own.bytes_per_second
    ):
        return Cost(load, used, None, own.bytes_per_second, keep=topic.kept)
    shares = allot(capacity.bytes_per_second, wishes | {"": own})
    sufferers = tuple(
        Sufferer(route.topic, wish.bytes_per_second, shares[route.key])
        for route in routes
        if shares[route.key] < _SUFFERS * (wish := wishes[route.key]).bytes_per_second
    )
    return Cost(load, used, capacity, shares[""], sufferers, topic.kept)


def load_of(
    now: Snapshot, topic: Topic, *, type_name: str = "", rate: float | None = None, size: float | None = None
) -> LinkLoad:
    """Estimate the load of a topic; `cost_of` describes the arguments."""
    type_name = type_name or ("" if topic.type == "auto" else topic.type)
    # A session file may have a short name: `Image` for `sensor_msgs/msg/Image`.
    known = (*TYPICAL, *(route.type_name for route in now.routes))
    full = {name for name in known if name.rpartition("/")[2] == type_name}
    if "/" not in type_name and len(full) == 1:
        type_name = full.pop()
    rate = rate or topic.expected_rate
    found = _measured(now.routes, topic, type_name)
    if found is None and type_name in TYPICAL:
        found = LinkLoad(*TYPICAL[type_name], LoadSource.TYPICAL)
    if rate is not None and size is not None:
        found = LinkLoad(rate, size, LoadSource.GIVEN)
    elif found is None:
        return LinkLoad(rate or 0.0, size or 0.0, LoadSource.UNKNOWN)
    found = found._replace(rate=rate or found.rate, size=size or found.size)
    return found if topic.max_rate is None else found._replace(rate=min(found.rate, topic.max_rate))


def _measured(routes: Iterable[RouteSnapshot], topic: Topic, type_name: str) -> LinkLoad | None:
    alike = None
    for route in routes:
        if route.calls is not None:
            continue
        if route.rate > 0.0 and route.state.flows:
            rate, size = route.rate, route.bytes_per_second / route.rate
        elif route.expected_rate and route.messages_total:  # its present rates fade while it is paused, for instance
            rate, size = route.expected_rate, route.bytes_total / route.messages_total
        else:
            continue
        load = LinkLoad(rate, size, LoadSource.HERE, route.topic)
        if (route.spec.topic, route.spec.direction) == (topic.topic, topic.direction):
            return load
        if type_name and route.type_name == type_name and alike is None:
            alike = load._replace(source=LoadSource.ALIKE)
    return alike


def as_report(cost: Cost) -> dict[str, object]:
    """Convert a cost for programs: in bytes/s, Hz and bytes."""
    capacity = cost.capacity
    return {
        "bytes_per_second": cost.load.bytes_per_second,
        "rate": cost.load.rate,
        "size": cost.load.size,
        "source": cost.load.source.value,
        "used": cost.used,
        "capacity": None if capacity is None else capacity.bytes_per_second,
        "capacity_source": None if capacity is None else str(capacity.source),
        "over": cost.over,
        "gets": cost.gets,
        "suffers": [each._asdict() for each in cost.sufferers],
        "kept_bytes": cost.kept,
    }


# --- in words


class CostText(Wording):
    """Texts about a topic's load, its cost on a link and the topics that would suffer."""

    UNKNOWN = "cost on the link: unknown, no topic of this type is bridged; give --rate and --size"
    LOAD = "about {amount} ({rate:.3g} Hz × {size}, {source})"
    CAPACITY_UNKNOWN = "{load}; the link's capacity is not known yet"
    IN_USE = "{load}; the link {capacity}, {used} in use"
    GIVEN = "given"
    HERE = "measured on {topic}"
    ALIKE = "as {topic} of the same type"
    TYPICAL = "usual for its type, not measured"
    CARRIED = "has carried {rate} at most"
    CARRIES = "carries {rate} (measured {age} ago)"
    CROWDS = "slows {topics}: set priority: high where it matters"
    CROSSES = "{share:.0%} of its own messages would cross"
    TOO_MUCH = "{amount} too much: {effects}"
    PERHAPS_TOO_MUCH = "{amount} more than ever crossed. If the link cannot carry it: {effects}"
    KEPT = "keep: {seconds:g} s of it are {size}, of {most} for all such topics of the link"
    KEPT_OF_ITS_OWN = "keep: {seconds:g} s of it are {size}, of {most} of its own"
    PERHAPS_CARRIED = "{amount} more than ever crossed: the link may or may not carry it"


def describe_cost(cost: Cost, now: float) -> tuple[str, ...]:
    """Return one to three lines for an operator, at `now` (s since the epoch)."""
    return _describe_load(cost, now) + _describe_kept(cost)


def _describe_kept(cost: Cost) -> tuple[str, ...]:
    if cost.keep is None or not cost.kept:
        return ()
    own, figures = cost.keep.own_bytes, {"seconds": cost.keep.seconds, "size": _bytes(cost.kept)}
    if own is not None:
        return (CostText.KEPT_OF_ITS_OWN(**figures, most=_bytes(own)),)
    return (CostText.KEPT(**figures, most=f"{KEEP_BUDGET >> 20} MiB"),)


def _describe_load(cost: Cost, now: float) -> tuple[str, ...]:
    if cost.load.source is LoadSource.UNKNOWN:
        return (CostText.UNKNOWN(),)
    load, capacity = cost.load, cost.capacity
    size, source = load.size, CostText[load.source.name](topic=load.like)
    what = CostText.LOAD(amount=amount(load.bytes_per_second), rate=load.rate, size=_bytes(size), source=source)
    if capacity is None:
        return (CostText.CAPACITY_UNKNOWN(load=what),)
    carries = CostText.CARRIED if capacity.source == CapacitySource.SEEN else CostText.CARRIES
    carried = carries(rate=amount(capacity.bytes_per_second), age=about(capacity.age(now)))
    first = CostText.IN_USE(load=what, capacity=carried, used=amount(cost.used))
    if not cost.over:
        return (first,)
    names = join_first([f"{each.topic} to {each.after / each.before:.0%}" for each in cost.sufferers], _NAMED)
    parts = []
    if cost.sufferers:
        parts.append(CostText.CROWDS(topics=names))
    if cost.gets < _SUFFERS * load.bytes_per_second:
        parts.append(CostText.CROSSES(share=cost.gets / load.bytes_per_second))
    effects, over = "; ".join(parts), amount(cost.over)
    if capacity.source != CapacitySource.SEEN:
        return first, CostText.TOO_MUCH(amount=over, effects=effects)
    return first, (CostText.PERHAPS_TOO_MUCH if effects else CostText.PERHAPS_CARRIED)(amount=over, effects=effects)


def _bytes(size: float) -> str:
    return f"{size / 1e6:.2g} MB" if size >= 1e6 else f"{size / 1e3:.3g} kB" if size >= 1e3 else f"{size:.0f} B"


def amount(bytes_per_second: float) -> str:
    """Format bytes per second: ``1.1 MB/s``."""
    for unit, name in ((1e6, "MB/s"), (1e3, "kB/s")):
        if bytes_per_second >= unit:
            return f"{bytes_per_second / unit:.3g} {name}"
    return f"{bytes_per_second:.0f} B/s"
