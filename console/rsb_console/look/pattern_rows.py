"""Patterns as rows among the topics: they have a state, and no figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.snapshot import Ledger, RouteSnapshot

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.snapshot import PatternSnapshot, Snapshot


@dataclass(frozen=True, slots=True)
class PatternRow(RouteSnapshot):
    """A pattern in a list of routes.

    Attributes:
        routes: that it has made.
    """

    routes: int = 0


def pattern_rows(snapshot: Snapshot) -> Iterator[PatternRow]:
    """All patterns of a snapshot."""
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
        type_name="" if spec.type == "auto" else spec.type,
        type_hash="",
        qos=None,
        publisher_qos=None,
        subscriber_qos=None,
        transport=spec.protocol or "",
        port=0,
        stages=(),
        ledger=Ledger(),
        rate=0.0,
        expected_rate=None,
        bytes_per_second=0.0,
        bytes_total=0,
        latency_p50=None,
        latency_p99=None,
        latency_uncertainty=None,
        jitter=None,
        age=None,
        history=(),
        last_error="",
        acknowledged=pattern.acknowledged,
        routes=pattern.routes,
    )
