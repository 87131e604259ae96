"""Keys of a link whose routes are proposed already."""

from __future__ import annotations

from collections.abc import Iterable

from rsb_bridge.wire.sealing import CipherSuite, SessionKeys


def propose(keys: SessionKeys, routes: Iterable[int]) -> SessionKeys:
    """Derive the keys of routes as the proposals of both sides do; return the keys."""
    for route in routes:
        keys.proposed(route, "client" if route % 2 else "server")
    return keys


def session_keys(
    suite: CipherSuite,
    export: bytes | None,
    link_id: bytes = b"linklink",
    routes: Iterable[int] = (1, 2, 3, 4, 5, 6, 7),
) -> SessionKeys:
    """Return one side's keys of a link with these routes."""
    return propose(SessionKeys(suite, export, link_id), routes)
