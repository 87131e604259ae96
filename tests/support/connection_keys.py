"""Keys of a link whose routes are proposed already."""

from __future__ import annotations

from collections.abc import Iterable

from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys


def propose(keys: ConnectionKeys, routes: Iterable[int]) -> ConnectionKeys:
    """Derive the keys of routes as the proposals of both sides do; return the keys."""
    for route in routes:
        keys.proposed(route, "client" if route % 2 else "server")
    return keys


def connection_keys(
    suite: CipherSuite,
    export: bytes | None,
    link_id: bytes = b"linklink",
    routes: Iterable[int] = (1, 2, 3, 4, 5, 6, 7),
) -> ConnectionKeys:
    """Return one side's keys of a link with these routes."""
    return propose(ConnectionKeys(suite, export, link_id), routes)
