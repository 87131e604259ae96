"""Shows an engine on topics of its domain: its state as diagnostics, and who drives."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Endpoint, EnginePart, Level, Qos, RosError, TopicSpec, Wording, join_first
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.figure_table import Of, Unit, figures
from rsb_bridge.ros.announcements import Origin
from rsb_extras.exporters import DIAGNOSTICS_TOPIC, DRIVER_TOPIC
from rsb_extras.exporters.exporter_codes import ExporterCode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rsb_bridge.feature_api import Context, LinkSnapshot, Publisher, RouteSnapshot, SessionKey, Snapshot
    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.figure_table import Figure

_LEVELS = ("0", "1", "2")
"""OK, WARN and ERROR of ``diagnostic_msgs/DiagnosticStatus``, by severity."""
_FORMATS = {
    Unit.HERTZ: (" (Hz)", 1.0, ".1f"),
    Unit.BYTES_PER_SECOND: (" (B/s)", 1.0, ".0f"),
    Unit.SECONDS: (" (ms)", 1e3, ".1f"),
}
"""Text after a figure's name, factor, and format of the number."""
_LINK_FIGURES = figures(
    Of.LINK, "state", "cause", "peer", "peer_version", "cipher", "rtt", "clock_offset", "rx_bytes_per_second",
    "tx_bytes_per_second", "attempts",
)  # fmt: skip
_ROUTE_FIGURES = (
    *figures(Of.ROUTE, "state", "cause", "type_name", "rate", "expected_rate", "bytes_per_second"),
    *figures(Of.MESSAGES, "latency_p50", "latency_p99"),
)
_TOPIC_FIGURES = (
    *_ROUTE_FIGURES,
    *figures(Of.MESSAGES, "offered", "delivered", "throttled", "expired", "dropped", "unknown", "waiting"),
    *figures(Of.MESSAGES, "missed_while_down"),
)
_CALL_FIGURES = (*_ROUTE_FIGURES, *figures(Of.CALLS, "asked", "answered", "expired", "lost", "refused"))


def diagnostics(snapshot: Snapshot) -> Fields:
    """Return the fields of the message, as `rsb_bridge.ros.ros_interface.RosInterface.serialize` takes them.

    A status is named by the session, and by the link or by the topic and its direction, none of which changes when the
    bridge is started again. What is paused, disarmed or waits for a first message is OK: nothing is wrong.
    """
    links = [_link(snapshot.name, link) for link in snapshot.links]
    return {"header": "auto", "status": links + [_route(snapshot.name, route) for route in snapshot.routes]}


def _link(session: str, link: LinkSnapshot) -> Fields:
    severity = max(link.state.severity, int(bool(link.warning) or not link.encrypted))
    message = link.reason or link.warning or ("linked" if link.encrypted else "linked, not encrypted")
    values = _values(_LINK_FIGURES, link)
    return _status(f"rsb {session}: link {link.name}", session, severity, message, values)


def _route(session: str, route: RouteSnapshot) -> Fields:
    name = f"rsb {session}: {route.topic} {'to' if route.outgoing else 'from'} {route.link}"
    message = route.reason or (f"{route.rate:.1f} Hz" if route.state.flows else route.state.value)
    values = [*_values(_TOPIC_FIGURES if route.calls is None else _CALL_FIGURES, route)]
    if route.arming is not None:
        values.append(("armed by", route.arming.by))
    return _status(name, session, route.state.severity, message, values)


def _values(shown: tuple[Figure, ...], subject: LinkSnapshot | RouteSnapshot) -> Iterator[tuple[str, str]]:
    for each in shown:
        value = each.read(subject)
        if each.unit in _FORMATS:
            unit, factor, digits = _FORMATS[each.unit]
            yield f"{each.words}{unit}", "" if value is None else format(value * factor, digits)
        elif isinstance(value, dict):
            yield from ((f"{each.words}: {cause}", str(count)) for cause, count in value.items())
        else:
            yield each.words, str(value)


def _status(name: str, session: str, severity: int, message: str, values: Iterable[tuple[str, str]]) -> Fields:
    known: list[Fields] = [{"key": key, "value": value} for key, value in values if value]
    return {"level": _LEVELS[severity], "name": name, "message": message, "hardware_id": session, "values": known}


_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_QOS = Qos()  # as diagnostic_updater
_DRIVER_TYPE = "std_msgs/msg/String"
_NAMED = 3
"""Types in one text."""
_LATCHED = Qos(durability="transient_local", depth=1)


class DriverTopicText(Wording):
    """Reasons why nothing is published on the `driver_topic`, and why it is not bridged."""

    REFUSED = "{topic} is this side's driver_topic, which only the bridge publishes: choose another name"
    OTHER_TYPE = "nodes have it as {types}: give driver_topic a name of its own"
    BRIDGED = "it is bridged with {link}: give driver_topic a name of its own"


class _SessionTopic:
    """The bridge's publisher on a topic that a key of the session names. It belongs to the I/O thread.

    Args:
        key: of the session.
    """

    def __init__(self, context: Context, key: SessionKey[str | None], type_name: str, qos: Qos) -> None:
        self._context = context
        self._key, self._type, self._qos = key, type_name, qos
        self._publisher: Publisher | None = None
        self._searched: object = None
        self._searched_for: str | None = None
        self._bridged: Sequence[RouteSnapshot] = ()

    @property
    def name(self) -> str | None:
        """The topic that the session names now, or None."""
        return self._key.of(self._context.session)

    def open(self) -> None:
        """Publish from now on, on the topic that the session names now. What does not work ends nothing else."""
        self.close()
        topic = self.name
        if topic is None:
            return
        ros = self._context.ros
        type_hash = ros.installed_hash(self._type)
        if type_hash is None:
            # No warning: sessions have a `diagnostics_topic` by default, with or without this package.
            self.failed(f"{self._type} is not installed here", Level.INFO)
            return
        try:
            spec = TopicSpec(topic, self._type, type_hash, self._qos)
            self._publisher = ros.advertise(spec, self)
            endpoint = Endpoint(f"/{ros.node_name}", *spec[1:], self._publisher.gid)
            # As a node's, so that routes take it to other domains.
            self._context.announcements.announce(topic, self, endpoint, Origin(()))
        except RosError as error:
            self.failed(str(error))

    @property
    def is_open(self) -> bool:
        """Whether something can be published."""
        return self._publisher is not None

    def is_heard(self, snapshot: Snapshot) -> bool:
        """Whether anybody listens: a node, or this bridge itself, which takes the topic to another domain."""
        if self._publisher is None:
            return False
        return bool(self._publisher.subscriber_count) or any(each.outgoing for each in self.bridged(snapshot))

    def bridged(self, snapshot: Snapshot) -> Sequence[RouteSnapshot]:
        """Return its own routes. While nothing happens to any, a snapshot has the same ones."""
        name, routes = self.name, snapshot.routes
        if routes is not self._searched or name != self._searched_for:
            self._searched, self._searched_for = routes, name
            self._bridged = [each for each in routes if each.topic == name]
        return self._bridged

    def publish(self, fields: Fields) -> None:
        """Publish a message; a failure ends this."""
        if self._publisher is None:
            return
        try:
            self._publisher.publish(self._context.ros.serialize(self._type, fields, self._context.wall_ns()))
        except (RosError, FieldError) as error:
            self.failed(str(error))

    def failed(self, why: str, level: Level = Level.WARNING) -> None:
        self._context.log(level, ExporterCode.DIAGNOSTICS, f"nothing is published on {self.name}: {why}")
        self.close()

    def close(self) -> None:
        """Publish no more. May be called twice."""
        if self._publisher is not None:
            self._context.announcements.withdraw(self._publisher.gid)
            self._publisher.close()
            self._publisher = None


class DiagnosticsExporter(EnginePart):
    """Publishes the state of links and routes on the session's `diagnostics_topic`, while somebody listens."""

    def __init__(self, context: Context, look: Callable[[], Snapshot]) -> None:
        super().__init__()
        self._look = look
        self._topic = _SessionTopic(context, DIAGNOSTICS_TOPIC, _TYPE, _QOS)
        self.by_key = (((DIAGNOSTICS_TOPIC.name,), self.open),)

    def open(self) -> None:
        self._topic.open()

    def tick(self, snapshot: Snapshot) -> None:
        if self._topic.is_heard(snapshot):
            self._topic.publish(diagnostics(self._look()))

    async def close(self) -> None:
        self._topic.close()


class DriverExporter(EnginePart):
    """Publishes who holds which topic, on the session's `driver_topic`: latched, and when it changes."""

    def __init__(self, context: Context, look: Callable[[], Snapshot]) -> None:
        super().__init__()
        self._context = context
        self._look = look
        self._topic = _SessionTopic(context, DRIVER_TOPIC, _DRIVER_TYPE, _LATCHED)
        self._published = self._clash = ""
        self.by_key = (((DRIVER_TOPIC.name,), self.open),)

    def open(self) -> None:
        # The new name may clash for the same reason, which is logged again then.
        self._clash = ""
        if self._clashes(self._look()):
            self._topic.close()
        else:
            self._open()

    def _open(self) -> None:
        # A new publisher has no latched message yet for late subscribers.
        self._published = ""
        self._topic.open()

    def tick(self, snapshot: Snapshot) -> None:
        before = self._clash
        if self._clashes(snapshot):
            return
        # The clash had closed it.
        if before:
            self._open()
        if self._topic.is_open and (text := holders(snapshot)) != self._published:
            self._published = text
            self._topic.publish({"data": text})

    async def close(self) -> None:
        self._topic.close()

    def _clashes(self, snapshot: Snapshot) -> bool:
        """Whether the topic is not this bridge's alone. Then nothing is published, and one warning is logged."""
        before, self._clash = self._clash, self._bridged(snapshot) or self._other_types()
        if self._clash and self._clash != before:
            self._topic.failed(self._clash)
        return bool(self._clash)

    def _bridged(self, snapshot: Snapshot) -> str:
        """Return who bridges the topic since before the session named it, in words; later routes are refused."""
        links = sorted({route.link for route in self._topic.bridged(snapshot)})
        return DriverTopicText.BRIDGED(link=join_first(links, _NAMED)) if links else ""

    def _other_types(self) -> str:
        """Return what types other than the bridge's own nodes have on the topic, in words."""
        ros, topic = self._context.ros, self._topic.name
        if topic is None:
            return ""
        try:
            found = {each.type_name for each in (*ros.publishers(topic), *ros.subscriptions(topic))}
        except RosError:
            return self._clash  # the node ends, or is not there yet
        others = sorted(found - {_DRIVER_TYPE, ""})
        return DriverTopicText.OTHER_TYPE(types=join_first(others, _NAMED)) if others else ""


def holders(snapshot: Snapshot) -> str:
    """Return who has armed what, as a JSON list."""
    armed = ((route, route.arming) for route in snapshot.routes if route.arming is not None and route.arming.armed)
    return json.dumps(
        [{"topic": route.topic, "link": route.link, "holder": each.by, "here": each.here} for route, each in armed],
        ensure_ascii=False,
    )
