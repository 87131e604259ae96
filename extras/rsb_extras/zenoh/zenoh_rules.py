"""The rules of a session's Zenoh network: its mistakes, what its operator should know, and what its clients get."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from msgspec.structs import replace

from rsb_bridge.config.advice import interface_problem
from rsb_bridge.config.decoding import did_you_mean, join, show
from rsb_bridge.config.validation import SessionMistake, lacks_zone
from rsb_bridge.feature_api import Wording
from rsb_extras.zenoh import ZENOH, ZENOH_HOST
from rsb_extras.zenoh.zenoh_traits import ZenohTraits

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Session
    from rsb_extras.zenoh import ZenohSettings

_PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
"""Protocols of endpoints. The wheel knows more."""
_HOST = r"\[[0-9A-Fa-f:.]+(%[^\]\s]+)?\]|[^\[\]:/\s]+"
_ENDPOINT = re.compile(rf"(?P<protocol>[a-z0-9_]+)/(?P<host>{_HOST}):(?P<port>\d{{1,5}})([?#]\S*)?")
_FLEET_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_MOST_ENDPOINTS = 16  # a round figure: Zenoh tries them in turn (zenoh.md)


class ZenohMistake(Wording):
    """A mistake in the settings of a Zenoh network."""

    MISSING = "missing: server_ip is zenoh; give the routers' endpoints, {{connect: [tls/hub:7447]}}"
    FLEET_INVALID = "{name} is not a fleet's name: letters, digits, _, . and -, a letter or digit first, at most 64"
    PROTOCOL_UNKNOWN = "{protocol} is not one of {protocols}{hint}"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes in a session's network, and where it is missing."""
    settings, over_zenoh = ZENOH.of(session), session.host == ZENOH_HOST
    if over_zenoh and session.bluetooth_address is not None:
        yield "bluetooth_address", "a link over Zenoh cannot have topics over Bluetooth: leave it out"
    if settings is not None:
        yield from settings_problems(settings, ZENOH.name)
    elif over_zenoh:
        yield ZENOH.name, ZenohMistake.MISSING()


def settings_problems(settings: ZenohSettings, location: str) -> Iterator[tuple[str, str]]:
    """Yield the mistakes in how a network is reached."""
    if not (settings.connect or settings.listen or settings.config):
        yield location, "has no endpoint: give connect: [tls/hub:7447], or a config that does"
    for key, endpoints in (("connect", settings.connect), ("listen", settings.listen)):
        if len(endpoints) > _MOST_ENDPOINTS:
            yield join(location, key), f"has {len(endpoints)} endpoints, and at most {_MOST_ENDPOINTS} are allowed"
        for at, endpoint in enumerate(endpoints):
            if mistake := _endpoint_mistake(endpoint):
                yield join(join(location, key), at), mistake
    if not _FLEET_NAME.fullmatch(settings.fleet):
        yield join(location, "fleet"), ZenohMistake.FLEET_INVALID(name=show(settings.fleet))


def _endpoint_mistake(endpoint: str) -> str:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None:
        return f"{show(endpoint)} is not an endpoint: PROTOCOL/HOST:PORT, as in tls/hub:7447"
    protocol, host, port = match["protocol"], match["host"].strip("[]"), match["port"]
    if protocol not in _PROTOCOLS:
        hint = did_you_mean(protocol, list(_PROTOCOLS))
        return ZenohMistake.PROTOCOL_UNKNOWN(protocol=show(protocol), protocols=", ".join(_PROTOCOLS), hint=hint)
    if lacks_zone(host):
        return SessionMistake.ZONE_MISSING(address=host)
    return "" if 0 < int(port) < 65536 else f"{port} is not a port: 1 to 65535"


def advice(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the interfaces and the package that a valid session needs and this machine does not have."""
    settings = ZENOH.of(session)
    if settings is None:
        return
    for key, endpoints in (("connect", settings.connect), ("listen", settings.listen)):
        for at, match in enumerate(map(_ENDPOINT.fullmatch, endpoints)):
            if match is not None and (problem := interface_problem(match["host"].strip("[]"))):
                yield join(join(ZENOH.name, key), at), problem
    # A link over Zenoh has it from its transport.
    if session.host != ZENOH_HOST and (problem := ZenohTraits.missing()):
        yield ZENOH.name, problem


def client_session(session: Session, client: Session, address: str, port: int | None) -> Session:
    """Return a client's session with its server's network: the same routers, or the server's own addresses.

    Args:
        address: of the server as an operator gives it, with the port; over Zenoh, of the endpoint where it listens.
    """
    settings = ZENOH.of(session)
    if settings is None:
        return client
    over_zenoh = session.host == ZENOH_HOST
    connect = settings.connect
    if not connect and settings.listen:
        from rsb_console.session.client_files import own_address  # noqa: PLC0415 -- a bridge has no console

        protocol, _, place = settings.listen[0].partition("/")
        host = address or own_address()
        bracketed = f"[{host}]" if ":" in host else host
        port_there = port if over_zenoh and port is not None else place.rpartition(":")[2]
        connect = (f"{protocol}/{bracketed}:{port_there}",)
    client = replace(client, features={**client.features, ZENOH.name: replace(settings, connect=connect, listen=())})
    return replace(client, server_ip=ZENOH_HOST, server_port=session.server_port) if over_zenoh else client
