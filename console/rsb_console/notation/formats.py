"""Formats for figures, times, kinds and types of routes, and answers, and for patterns as rows."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

from rsb_bridge.model.names import other_side
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.snapshot import RouteSnapshot
from rsb_bridge.model.text import join_first, plural
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.model.verdict import LinkCause, duration
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.calls import CallsSnapshot
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import Acknowledgement, Driver, LinkSnapshot, PatternSnapshot, Snapshot, State

KIND_NOUN: dict[Kind, str] = {"topic": "topic", "service": "service", "action": "action", "parameters": "parameters"}
KIND_SHORT: dict[Kind, str] = {"topic": "msg", "service": "srv", "action": "act", "parameters": "par"}
"""Kinds as they fit into a narrow column; the first three are ROS's own names for the types."""
AGE_STEP = 0.1
"""s: the least difference that an age shows."""
_LIMITED = 0.9
"""Share of a limit from which on an expected rate is due to it: a throttled topic has a little less. A round figure."""
_DAY = 86_400.0
_DRIVERS_NAMED = 4  # in a question. A round figure
_NODES_NAMED = 3  # nodes in a report; the others are counted. A round figure


class AnswerText(Wording):
    """Reports on calls by hand."""

    ANSWERED = "{link}: answered by {nodes} {where}, after {seconds:.3g} s"
    THERE, HERE = "there", "on this side"


class DriverText(Wording):
    """Texts about those who publish what moves a robot."""

    BY_HAND, UNKNOWN = "messages by hand", "a node that is not known yet"
    RATE = "{who} ({rate} Hz)"
    THERE = "{who} on the other side"
    NOBODY = "Nobody publishes it now."
    ONE = "{who} publishes it now: the robot follows at once."
    SEVERAL = "{who} publish it now: the robot follows all of them at once."


def thousands(count: int) -> str:
    """Format a count with spaces between the thousands: ``7 134``."""
    return f"{count:,}".replace(",", " ")


def hertz(rate: float) -> str:
    """Format a rate in Hz, without the unit, in at most five characters: ``0.2``, ``49.8``, ``1000``."""
    return f"{rate:.0f}" if rate >= 100 or rate == 0 else f"{rate:.1f}"


def expected(rate: float) -> str:
    """Format an expected rate in Hz, without the unit: ``10``, ``0.5``, ``1000``."""
    # From 1000 on, .3g would give 1e+03.
    return f"{rate:.3g}" if rate < 1000 else f"{rate:.0f}"


def unsaved_there(snapshot: Snapshot) -> str:
    """Name the sides whose files lack a change that was made here, or return an empty string."""
    names = [other_side(snapshot.role, link.name) for link in snapshot.links if link.unsaved_there]
    return join_first(names, _NODES_NAMED)


def limit(route: RouteSnapshot) -> float | None:
    """Return the limit (Hz) that a topic's messages keep to, or None if fewer are expected anyway."""
    rate, highest = route.expected_rate, route.max_rate
    return None if highest is None or (rate is not None and rate < _LIMITED * highest) else highest


def beside_rate(route: RouteSnapshot) -> str:
    """Return the figure that a topic's rate is compared with: ``/10`` expected, ``≤1`` allowed, or nothing."""
    if (highest := limit(route)) is not None:
        return f"≤{expected(highest)}"
    return "" if route.expected_rate is None else f"/{expected(route.expected_rate)}"


def rate_by_name(route: RouteSnapshot) -> str:
    """Return the same in words, such as ``usual: 10 Hz``, or nothing."""
    if (highest := limit(route)) is not None:
        return f"limit: {expected(highest)} Hz"
    if route.expected_rate is None:
        return ""
    return f"{'expected' if route.spec.expected_rate else 'usual'}: {expected(route.expected_rate)} Hz"


def milliseconds(seconds: float) -> str:
    """Format a latency in ms, without the unit, in at most five characters: ``0.3``, ``3.1``, ``1204``."""
    value = max(0.0, seconds * 1e3)  # a negative latency comes from the error of the clock offset
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def byte_rate(bytes_per_second: float) -> str:
    """Format a data rate in at most eight characters: ``412 B/s``, ``9.4 kB/s``, ``312 kB/s``, ``3.1 MB/s``."""
    if bytes_per_second < 1e3:
        return f"{bytes_per_second:.0f} B/s"
    value, unit = (bytes_per_second / 1e6, "MB/s") if bytes_per_second >= 1e6 else (bytes_per_second / 1e3, "kB/s")
    return f"{value:.1f} {unit}" if value < 9.95 else f"{value:.0f} {unit}"  # from 9.95 on, .1f gives 10.0


def byte_count(count: int) -> str:
    """Format a number of bytes in at most seven characters: ``412 B``, ``9.4 kB``, ``312 MB``, ``3.1 TB``."""
    value, unit = float(count), "B"
    for larger in ("kB", "MB", "GB", "TB", "PB"):
        # From here on, .0f gives 1000 kB instead of 1.0 MB.
        if value < 999.5:
            break
        value, unit = value / 1e3, larger
    return f"{value:.1f} {unit}" if value < 9.95 and unit != "B" else f"{value:.0f} {unit}"


def kilobytes(bytes_per_second: float) -> str:
    """Format a data rate in kB/s, without the unit, in at most six characters."""
    value = bytes_per_second / 1e3
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def span(seconds: float) -> str:
    """Format a duration with two or three digits: ``12 µs``, ``3.1 ms``, ``1.25 s``, ``3 min``, ``729 d``."""
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} µs"
    if seconds < 1:
        return f"{seconds * 1e3:.1f} ms"
    return f"{seconds:.2f} s" if seconds < 100 else duration(seconds)


def loss(links: Iterable[LinkSnapshot]) -> str:
    """Format the worst loss of packets of some links: ``30 %``, or an empty string below 1 %."""
    worst = max((share for link in links for share in (link.loss_out, link.loss_in) if share is not None), default=0.0)
    return f"{100 * worst:.0f} %" if worst >= 0.01 else ""


def via(link: LinkSnapshot) -> str:
    """Format the device that carries a link, and the other ways: ``via wlan0 (lte0 ready)``, or an empty string."""
    if not link.ways:
        return f"via {link.via}" if link.via else ""
    used = next((link.via or way.host for way in link.ways if way.is_used), "")
    if not used:
        return ""
    words = {True: "ready", False: "not ready"}
    # Of ways over one device, the address tells which one it is.
    others = [
        f"{way.host if way.device in ('', used) else way.device} {words[way.is_ready]}"
        for way in link.ways
        if not way.is_used
    ]
    return f"via {used} ({', '.join(others)})" if others else f"via {used}"


def latency(seconds: float, uncertainty: float | None) -> str:
    """Format a latency as `span` does; one that the error of the clock offset made negative as ``<0.4 ms``.

    Args:
        uncertainty: error of the clock offset in s, or None if unknown.
    """
    if seconds > 0:
        return span(seconds)
    return f"<{span(uncertainty)}" if uncertainty else span(0.0)


def age(seconds: float) -> str:
    """Format an age in at most five characters: ``0.1s``, ``31s``, ``12m``, ``3h``, ``5d``."""
    if seconds < 10:
        return f"{max(seconds, 0.0):.1f}s"
    if seconds < 100:
        return f"{seconds:.0f}s"
    for size, unit in ((86400, "d"), (3600, "h"), (60, "m")):
        if seconds >= size:
            return f"{seconds / size:.0f}{unit}"
    return f"{seconds:.0f}s"


def age_since(since: float, now: float) -> str:
    """Format the time from `since` to `now` (s) as `age`, in whole seconds: ``4s``, ``31s``, ``12m``."""
    # Both cut to whole seconds: so all such figures of a screen change at one moment, in one redrawing.
    seconds = max(0, math.floor(now) - math.floor(since))
    return f"{seconds}s" if seconds < 100 else age(seconds)


def age_of(last_at: float, now: float) -> str:
    """Format the age of the last message: with tenths below 10 s, then as `age_since`, like the reason of a silence."""
    return age(now - last_at) if now - last_at < 10 else age_since(last_at, now)


def clock(seconds: float) -> str:
    """Format a duration as hours, minutes and seconds: ``00:12:04``."""
    whole = max(0, int(seconds))
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def next_attempt(link: LinkSnapshot, now: float | None = None) -> str:
    """Format the time until a link is tried again, or its client asks again: ``retry 4 in 3 s``, ``retry 4 now``.

    Args:
        now: s, so that the seconds change together with `age_since`, or None.
    """
    seconds = link.retry_in
    if seconds is None:
        return ""
    if seconds and now is not None:
        # At least 1: 0 means that the attempt runs now.
        seconds = max(1, math.floor(now + seconds) - math.floor(now))
    if link.cause == LinkCause.SHUT_DOWN:
        return f"asks again in {math.ceil(seconds)} s"
    return f"retry {link.attempts + 1} {f'in {math.ceil(seconds)} s' if seconds else 'now'}"


def waits(link: LinkSnapshot, now: float) -> str:
    """Format how long topics and calls still wait for a link that is away, or return an empty string."""
    if link.association_ends is None:
        return ""
    # Cut to whole seconds, as in `age_since`.
    return f"topics and calls wait {max(0, math.floor(link.association_ends) - math.floor(now))} s more"


def counted(count: int, what: str) -> str:
    """Format a count of things: ``1 topic``, ``8 topics``."""
    return f"{thousands(count)} {plural(count, what)}"


def time_of_day(epoch: float) -> str:
    """Format a time (s since the epoch) as local time of day: ``02:31:07``."""
    return time.strftime("%H:%M:%S", time.localtime(epoch))


def minute(epoch: float) -> str:
    """Format a time (s since the epoch) as ``02:31``, or as ``2026-11-24 02:31`` if it was more than a day ago."""
    return time.strftime("%H:%M" if time.time() - epoch < _DAY else "%Y-%m-%d %H:%M", time.localtime(epoch))


def qos_parts(qos: Qos, *, depth_known: bool = True) -> list[str]:
    """Format a QoS as pieces of a list: ``reliable,`` ``volatile,`` ``last 10``.

    Args:
        qos: to format. A depth of 0 means that the bridge chooses it: by the topic's rate, or by the depth of a latched
            topic's publishers.
        depth_known: whether to include history and depth.
    """
    parts = [qos.reliability.replace("_", " "), qos.durability.replace("_", " ")]
    if depth_known:
        parts.append("all" if qos.history == "keep_all" else f"last {qos.depth}" if qos.depth else "auto depth")
    if qos.deadline:
        parts.append(f"deadline {span(qos.deadline)}")
    if qos.lifespan:
        parts.append(f"lifespan {span(qos.lifespan)}")
    if qos.liveliness != "automatic":
        parts.append(qos.liveliness.replace("_", " "))
    if qos.liveliness_lease_duration:
        parts.append(f"lease {span(qos.liveliness_lease_duration)}")
    return [f"{each}," for each in parts[:-1]] + parts[-1:]


def driver(each: Driver) -> str:
    """Name a driver, with its side and its rate while it sends: ``/joystick (10 Hz)``."""
    who = driver_name(each)
    who = DriverText.RATE(who=who, rate=driver_rate(each.rate)) if each.rate else who
    return who if each.here else DriverText.THERE(who=who)


def driver_name(each: Driver) -> str:
    return DriverText.BY_HAND() if each.by_hand else each.name or DriverText.UNKNOWN()


def driver_rate(rate: float) -> str:
    """Format a driver's rate in Hz, without the unit, in so few digits that it stays the same: ``10``, ``0.5``."""
    return f"{rate:.2g}" if rate < 99 else f"{rate:.0f}"


def drivers_now(route: RouteSnapshot) -> str:
    """Return who publishes a topic that moves a robot, in a sentence for the operator who arms it."""
    # The publisher for messages by hand stays for some seconds after the last one.
    found = [driver(each) for each in route.drivers if each.rate or not each.by_hand]
    if not found:
        return DriverText.NOBODY()
    return (DriverText.ONE if len(found) == 1 else DriverText.SEVERAL)(who=join_first(found, _DRIVERS_NAMED))


def known_type(route: RouteSnapshot) -> str:
    """Return a route's type, or the configured one until the bridge has seen it, or an empty string."""
    if route.type_name or route.spec.type == AUTO:
        return route.type_name
    return f"{route.spec.type} (as configured)"


def full_type(route: RouteSnapshot) -> str:
    """Return the full name of a route's type, or an empty string if nobody on this side knows it."""
    if route.type_name or route.spec.type == AUTO:
        return route.type_name
    return expand_type_name(route.spec.type)


def counted_kinds(kinds: Iterable[Kind]) -> str:
    """Format a count of routes: ``8 topics, 2 services, parameters of 1 node``; of none, ``0 topics``."""
    counts = Counter(kinds)
    # A route of parameters is named by its node: "2 parameters" would be two values.
    nodes = counts.pop("parameters", 0)
    parts = [counted(counts[kind], noun) for kind, noun in KIND_NOUN.items() if counts[kind]]
    parts += [f"parameters of {counted(nodes, 'node')}"] if nodes else []
    return ", ".join(parts) or counted(0, "topic")


def answer_report(route: RouteSnapshot, seconds: float) -> str:
    """Return the report of a call by hand, which was answered after so many seconds."""
    nodes = join_first(route.subscribers, _NODES_NAMED) or "a node"
    where = AnswerText.THERE() if route.outgoing else AnswerText.HERE()
    return AnswerText.ANSWERED(link=route.link, nodes=nodes, where=where, seconds=seconds)


def unanswered(calls: CallsSnapshot) -> int:
    """Return the number of calls that will get no reply."""
    return calls.expired + calls.lost + sum(calls.refused.values())


class RowText(Wording):
    """The reasons why a row of a list of topics is not one whose messages can be shown."""

    IS_PATTERN = "{topic} is a pattern: choose a topic that it matches"
    NO_MESSAGES = "{topic} has calls, no messages"
    NO_MESSAGES_BUT_CALLS = "{topic} has calls, no messages: {key} calls it by hand"


@dataclass(frozen=True, slots=True)
class PatternRow:
    """A pattern in a list of topics. It carries nothing, so that it has no figures, endpoints or arming.

    Attributes:
        topic: its names on this side.
        remote_topic: its names on the other side.
        outgoing: as of a route.
        routes: number of routes that it has made.
    """

    key: str
    link: str
    topic: str
    remote_topic: str
    outgoing: bool
    spec: Topic
    state: State
    reason: str
    acknowledged: Acknowledgement | None
    routes: int
    arming: ClassVar[None] = None
    cause: ClassVar[str] = ""
    pattern: ClassVar[str] = ""

    @property
    def transport(self) -> str:
        """The transport that its entry chooses, or an empty string."""
        return self.spec.protocol or ""

    @property
    def type_name(self) -> str:
        """The only type that it bridges, or an empty string for any."""
        return "" if self.spec.type == AUTO else self.spec.type


Row: TypeAlias = RouteSnapshot | PatternRow
"""A row of a list of topics."""


def rows_of(snapshot: Snapshot) -> Iterator[Row]:
    """Yield the rows of the routes, and of the patterns that make some of them."""
    yield from snapshot.routes
    yield from pattern_rows(snapshot)


def pattern_rows(snapshot: Snapshot) -> Iterator[PatternRow]:
    for link in snapshot.links:
        for pattern in link.patterns:
            yield _row(pattern, is_client=snapshot.role == "client")


def _row(pattern: PatternSnapshot, *, is_client: bool) -> PatternRow:
    spec = pattern.spec
    from_client = pattern.here == is_client
    on_client = spec.topic
    on_server = (spec.remote_topic or spec.topic) if from_client else pattern.source
    return PatternRow(
        key=pattern.key,
        link=pattern.link,
        topic=on_client if is_client else on_server,
        remote_topic=on_server if is_client else on_client,
        outgoing=(spec.direction == "transmit") == is_client,
        spec=spec,
        state=pattern.state,
        reason=pattern.reason,
        acknowledged=pattern.acknowledged,
        routes=pattern.routes,
    )
