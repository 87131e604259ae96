"""A link as user interfaces show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.pattern_snapshots import snapshots_of
from rsb_bridge.model.snapshot import LinkSnapshot
from rsb_bridge.telemetry.meters import ClockOffset

if TYPE_CHECKING:
    from rsb_bridge.link.link import Link


def snapshot_of(link: Link) -> LinkSnapshot:
    """The link as it is now."""
    now = link.context.now()
    keepalive, keys, peer = link.keepalive, link.keys, link.peer
    clock = keepalive.clock if link.linked else ClockOffset()  # what a dead connection measured holds no more
    return LinkSnapshot(
        name=link.name,
        peer=link.address,
        state=link.status.state,
        reason=link.down_reason,
        since=link.status.since,
        retry_in=link.status.retry_in(now),
        attempts=link.status.attempts,
        encrypted=link.encrypted,
        cipher=keys.suite.name if keys and link.encrypted else "",
        fingerprint=link.fingerprints[0],
        next_fingerprint=link.fingerprints[1],
        rtt=clock.rtt,
        clock_offset=clock.offset,
        clock_uncertainty=clock.uncertainty,
        rx_bytes_per_second=keepalive.rx_rate if link.linked else 0.0,
        tx_bytes_per_second=keepalive.tx_rate if link.linked else 0.0,
        rx_bytes_total=keepalive.rx_bytes,
        tx_bytes_total=keepalive.tx_bytes,
        peer_version=peer.version if peer else "",
        peer_domain=peer.domain_id if peer else None,
        use_name=link.use_name,
        cause=link.cause,
        warning=link.warning,
        warning_since=link.warning_since(),
        capacity_out=link.contention.sending.capacity,
        capacity_in=link.contention.receiving.capacity,
        full_out=link.full_out,
        full_in=link.full_in,
        patterns=tuple(snapshots_of(link.patterns)),
    )
