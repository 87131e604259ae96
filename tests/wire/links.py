"""Both ends of a link, with no socket between them."""

from typing import Any, TypeVar

import pytest
from tests.support.connection_keys import propose

from rsb_bridge.wire.connection import ClientConnection, ServerConnection
from rsb_bridge.wire.events import Established, Event
from rsb_bridge.wire.messages import Hello, Welcome
from rsb_bridge.wire.sealed_stream import Credential, ReplayCache
from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
ROUTES = (1, 3, 5, 7)
"""Routes that a client has proposed on an established link."""
HELLO = Hello(version="0.1.0", name="robot1", instance="abc", domain_id=2)
WELCOME = Welcome(version="0.1.0", name="pc", link_id=b"linklink", instance="def", domain_id=0)
T = TypeVar("T")
SUITES = pytest.mark.parametrize("suite", list(CipherSuite))
CONTROL_HEADER = bytes(14)


def key_for(suite: CipherSuite) -> bytes | None:
    return None if suite is CipherSuite.PLAIN else KEY


def make_client(suite: CipherSuite = CipherSuite.AESGCM, *, key: bytes = KEY, **options: Any) -> ClientConnection:
    return ClientConnection(HELLO, None if suite is CipherSuite.PLAIN else key, suite, **options)


def make_server(
    suite: CipherSuite = CipherSuite.AESGCM, *, keys: tuple[bytes, ...] = (KEY,), aes: bool = True, **options: Any
) -> ServerConnection:
    credential = Credential(() if suite is CipherSuite.PLAIN else keys, ReplayCache())
    return ServerConnection(lambda name: credential, lambda hello: WELCOME, aes, **options)


def the(kind: type[T], events: list[Event]) -> T:
    (event,) = events
    assert isinstance(event, kind)
    return event


def shake_hands(client: ClientConnection, server: ServerConnection) -> tuple[list[Event], list[Event]]:
    """Carry bytes both ways until neither has more to say. Gives the client's events and the server's."""
    client_events: list[Event] = []
    server_events = server.receive_data(client.start())
    while to_client := server.data_to_send():
        client_events += client.receive_data(to_client)
        server_events += server.receive_data(client.data_to_send())
    return client_events, server_events


def established(
    suite: CipherSuite = CipherSuite.AESGCM, **options: Any
) -> tuple[ClientConnection, ServerConnection, ConnectionKeys, ConnectionKeys]:
    """Both ends after the handshake, and the keys that each has from it."""
    client, server = make_client(suite, **options), make_server(suite, **options)
    (client_event,), (server_event,) = shake_hands(client, server)
    assert isinstance(client_event, Established)
    assert isinstance(server_event, Established)
    return client, server, propose(client_event.keys, ROUTES), propose(server_event.keys, ROUTES)


def ready_to_accept(suite: CipherSuite = CipherSuite.AESGCM) -> tuple[ClientConnection, ServerConnection]:
    client, server = make_client(suite), make_server(suite)
    server.receive_data(client.start())
    return client, server
