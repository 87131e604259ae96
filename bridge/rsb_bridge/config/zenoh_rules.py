"""The rules of how a session reaches its Zenoh network."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import did_you_mean, join, show
from rsb_bridge.model.session import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Session, ZenohSettings

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
"""What endpoints may begin with, of what the wheel knows."""

_HOST = r"\[[0-9A-Fa-f:.]+(%\w+)?\]|[^\[\]:/\s]+"
_ENDPOINT = re.compile(rf"(?P<protocol>[a-z0-9_]+)/(?P<host>{_HOST}):(?P<port>\d{{1,5}})([?#]\S*)?")

_FLEET = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_MOST_ENDPOINTS = 16


def zenoh_problems(session: Session) -> Iterator[Problem]:
    """Mistakes in a session's `Session.zenoh`, and where it is missing."""
    if session.is_zenoh and session.bluetooth_address is not None:
        yield Problem("bluetooth_address", "no topic crosses by Bluetooth beside a link over Zenoh: leave it out")
    if session.zenoh is None:
        if session.is_zenoh:
            message = "missing: server_ip is zenoh; give the routers' endpoints, {connect: [tls/hub:7447]}"
            yield Problem("zenoh", message)
        return
    yield from settings_problems(session.zenoh, "zenoh")


def settings_problems(settings: ZenohSettings, location: str) -> Iterator[Problem]:
    """Mistakes in how a network is reached."""
    if not (settings.connect or settings.listen or settings.config):
        yield Problem(location, "says no endpoint: give connect: [tls/hub:7447], or a config that does")
    for key, endpoints in (("connect", settings.connect), ("listen", settings.listen)):
        if len(endpoints) > _MOST_ENDPOINTS:
            yield Problem(
                join(location, key), f"has {len(endpoints)} endpoints, and at most {_MOST_ENDPOINTS} are allowed"
            )
        for at, endpoint in enumerate(endpoints):
            yield from _endpoint(endpoint, join(join(location, key), at))
    if not _FLEET.fullmatch(settings.fleet):
        message = "is not a fleet's name: letters, digits, _, . and -, a letter or digit first, at most 64"
        yield Problem(join(location, "fleet"), f"{show(settings.fleet)} {message}")


def _endpoint(endpoint: str, location: str) -> Iterator[Problem]:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None:
        yield Problem(location, f"{show(endpoint)} is not an endpoint: PROTOCOL/HOST:PORT, as in tls/hub:7447")
    elif match["protocol"] not in PROTOCOLS:
        hint = did_you_mean(match["protocol"], list(PROTOCOLS))
        yield Problem(location, f"{show(match['protocol'])} is not one of {', '.join(PROTOCOLS)}{hint}")
    elif not 0 < int(match["port"]) < 65536:
        yield Problem(location, f"{match['port']} is not a port: 1 to 65535")
