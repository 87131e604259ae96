"""The figures of links and routes: name, unit, help, and how a snapshot is read, once for all outputs.

Metrics take every figure that has a metric; `/diagnostics` and JSON name the figures that they show. What is shown
as the snapshot has it, such as a topic's name, needs no line here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum, auto
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.snapshot import LinkSnapshot


class Unit(StrEnum):
    """The unit of a figure, which says how many digits it has in each output."""

    NONE = auto()
    """A text, a number without a unit, or numbers by cause."""
    HERTZ = auto()
    BYTES_PER_SECOND = auto()
    SECONDS = auto()
    MOMENT = auto()
    """s since the epoch."""


class Of(StrEnum):
    """The subject of a figure; the metric's name begins with it."""

    LINK = "link"
    ROUTE = "route"
    MESSAGES = "messages"
    """The messages of a topic's route."""
    CALLS = "calls"
    """The calls of any other route."""


_PARTS = {Of.LINK: "", Of.ROUTE: "", Of.MESSAGES: "ledger.", Of.CALLS: "calls."}
"""The part of a snapshot that has a subject's figures."""


@dataclass(frozen=True)  # no slots: a cached property needs a dict
class Figure:
    """A figure of a link or a route."""

    of: Of
    name: str
    metric: str = ""
    """Its name in Prometheus after the subject, or empty if it is no metric. A counter's ends in ``_total``."""
    help: str = ""  # in Prometheus; figures with the same metric share the first one's
    unit: Unit = Unit.NONE
    shown: str = ""  # its name on ``/diagnostics`` without the unit, or empty for the words of `name`
    source: str | Callable[[Any], Any] = ""
    """An attribute of the `LinkSnapshot` or `RouteSnapshot`, or a function of it; empty for `name` in the subject's
    part."""
    by: str = ""
    """An additional label of the metric. Its values are the keys of the dict that is read, or the text that is read, or
    `at`."""
    at: str = ""  # the value of `by`, if it is always the same

    @cached_property
    def read(self) -> Callable[[Any], Any]:
        """Function that reads it from a snapshot of its link or route, and returns None if there is no figure."""
        source = self.source or f"{_PARTS[self.of]}{self.name}"
        return attrgetter(source) if isinstance(source, str) else source

    @cached_property
    def words(self) -> str:
        """Name on ``/diagnostics``, without the unit."""
        return self.shown or self.name.replace("_", " ")


_LINK, _ROUTE, _MESSAGES, _CALLS = Of
_HERTZ, _BYTES, _SECONDS, _MOMENT = Unit.HERTZ, Unit.BYTES_PER_SECOND, Unit.SECONDS, Unit.MOMENT


def _losses(link: LinkSnapshot) -> dict[str, float]:
    shares = {"out": link.loss_out, "in": link.loss_in}
    return {way: round(share, 3) for way, share in shares.items() if share is not None}


FIGURES = (
    Figure(_LINK, "up", "up", "1 while the link is up.", source=lambda link: link.state is State.OK),
    Figure(_LINK, "state_since", "since_timestamp_seconds", "When it came up or went down.", source="since"),
    Figure(_LINK, "encrypted", "encrypted", "1 if the link is encrypted."),
    Figure(_LINK, "warning", "warning", "1 if something is wrong though the link is up.",
            source=lambda link: bool(link.warning)),
    Figure(_LINK, "attempts", "failed_attempts", "Attempts to connect that failed since it was last up.",
            shown="failed attempts"),
    Figure(_LINK, "rtt", "round_trip_seconds", "Round-trip time of the last ping.", unit=_SECONDS, shown="round trip"),
    Figure(_LINK, "loss", "loss_ratio", "Share of the packets that are lost on the way, 0 to 1, out or in.",
            by="direction", source=_losses),
    Figure(_LINK, "clock_offset", "clock_offset_seconds", "The other side's clock minus this one's.", unit=_SECONDS),
    Figure(_LINK, "clock_uncertainty", "clock_uncertainty_seconds", "Error of the offset, and so of every latency.",
            unit=_SECONDS),
    Figure(_LINK, "rx_bytes_total", "receive_bytes_total", "Wire bytes received, over all connections of the link."),
    Figure(_LINK, "tx_bytes_total", "transmit_bytes_total", "Wire bytes sent, over all connections of the link."),
    Figure(_LINK, "full", "full", "1 while the link carries less than is asked of it, out or in.", by="direction",
            source=lambda link: {"out": link.full_out is not None, "in": link.full_in is not None}),
    Figure(_LINK, "state", "state", "Always 1; the state of the link.", by="state"),
    Figure(_LINK, "reason", source=lambda link: link.reason or link.warning),
    Figure(_LINK, "since", unit=_MOMENT, source="fault_since"),
    Figure(_LINK, "association_ends", unit=_MOMENT),
    Figure(_LINK, "cipher", source=lambda link: link.cipher if link.encrypted else "none"),
    Figure(_LINK, "rx_bytes_per_second", unit=_BYTES, shown="received"),
    Figure(_LINK, "tx_bytes_per_second", unit=_BYTES, shown="sent"),

    Figure(_ROUTE, "state", "state", "Always 1; the state of the route.", by="state"),
    Figure(_ROUTE, "level", "level", "How bad its state is: 0 nothing is wrong, 1 a warning, 2 an error.",
            source="state.severity"),
    Figure(_ROUTE, "since", "since_timestamp_seconds", "When its state began.", unit=_MOMENT),
    Figure(_ROUTE, "rate", "rate_hertz", "Messages or calls a second, over the last seconds.", unit=_HERTZ),
    Figure(_ROUTE, "expected_rate", "expected_rate_hertz", "As the session says, or learned.", unit=_HERTZ),
    Figure(_ROUTE, "last_at", "last_message_timestamp_seconds", "When the last message or call came.", unit=_MOMENT),
    Figure(_ROUTE, "bytes_total", "payload_bytes_total", "Payload that crossed this side."),
    Figure(_ROUTE, "bytes_per_second", unit=_BYTES, shown="payload"),
    Figure(_ROUTE, "kind", source="spec.kind"),
    Figure(_ROUTE, "pattern", source=lambda route: route.pattern or None),
    Figure(_ROUTE, "missing", source=lambda route: [stage.name for stage in route.stages if not stage.done]),
    Figure(_ROUTE, "drivers", source=lambda route: [asdict(each) for each in route.drivers]),
    Figure(_ROUTE, "type_name", shown="type"),
    Figure(_ROUTE, "provider", source="spec.provider"),

    Figure(_CALLS, "asked", "asked_total", "Calls taken from callers, or that came over the link."),
    Figure(_CALLS, "answered", "answered_total", "Calls whose answer went back."),
    Figure(_CALLS, "expired", "expired_total", "Calls given up after their timeout."),
    Figure(_CALLS, "lost", "lost_total", "Calls under way when the link or the provider went."),
    Figure(_CALLS, "late", "late_total", "Answers to calls that had been given up."),
    Figure(_CALLS, "in_flight", "in_flight", "Calls under way."),
    Figure(_CALLS, "waiting", "waiting", "Calls under way that wait until their node has taken earlier ones."),
    Figure(_MESSAGES, "offered", "offered_total", "Messages taken from ROS on the sending side."),
    Figure(_MESSAGES, "delivered", "delivered_total", "Messages published on the receiving side."),
    Figure(_MESSAGES, "throttled", "throttled_total", "Messages left out because an operator allows no more."),
    Figure(_MESSAGES, "expired", "expired_total", "Messages dropped because they were too old."),
    Figure(_MESSAGES, "unknown", "unknown_total",
            "Messages sent to a process that ended before it reported whether they arrived."),
    Figure(_MESSAGES, "lost_in_dds", "lost_in_dds_total", "Messages lost before the bridge could take them."),
    Figure(_MESSAGES, "missed_while_down", "missed_while_down_total", "Messages published while the route was closed."),
    Figure(_MESSAGES, "unsubscribed", "unsubscribed_total",
            "Messages published before the bridge subscribed, or while the topic was not to cross."),
    Figure(_MESSAGES, "again", "again_total", "Of the messages offered, a latched topic's that were offered before."),
    Figure(_MESSAGES, "jitter", "jitter_seconds", "Variation of the latency (RFC 3550).", unit=_SECONDS,
            source="jitter"),
    Figure(_MESSAGES, "waiting", "waiting", "Messages not sent yet."),
    Figure(_MESSAGES, "in_flight", "in_flight", "Messages that the receiving side has not reported yet."),
    Figure(_MESSAGES, "latency_p50", "latency_seconds",
            "One way, of the last messages; its error is the clock's uncertainty.", unit=_SECONDS, source="latency_p50",
            by="percentile", at="50"),
    Figure(_MESSAGES, "latency_p99", "latency_seconds", unit=_SECONDS, source="latency_p99", by="percentile", at="99"),
    Figure(_CALLS, "node_p50", "node_seconds", "What the providing node took, of the last calls.", unit=_SECONDS,
            by="percentile", at="50"),
    Figure(_CALLS, "node_p99", "node_seconds", unit=_SECONDS, by="percentile", at="99"),
    Figure(_CALLS, "way_p50", "way_seconds", "What the way there and back took, of the last calls.", unit=_SECONDS,
            by="percentile", at="50"),
    Figure(_CALLS, "way_p99", "way_seconds", unit=_SECONDS, by="percentile", at="99"),
    Figure(_MESSAGES, "dropped", "dropped_total", "Messages dropped, by cause.", by="cause"),
    Figure(_CALLS, "refused", "refused_total", "Calls refused, by cause.", by="cause"),
)  # fmt: skip

_BY_NAME = {(each.of, each.name): each for each in FIGURES}


def figures(of: Of, *names: str) -> tuple[Figure, ...]:
    """Return the figures with some names, or what the snapshot has by these names."""
    return tuple(_BY_NAME.get((of, name)) or Figure(of, name) for name in names)
