"""Both ends of a link, with no socket between them."""

import pytest

from rsb_bridge.wire.connection import ClientConnection, Credential, ServerConnection
from rsb_bridge.wire.messages import Hello, Welcome
from rsb_bridge.wire.sealing import Suite

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
HELLO = Hello(version="0.1.0", name="robot1", instance="abc", domain_id=2)
WELCOME = Welcome(version="0.1.0", name="pc", link_id=b"linklink", instance="def", domain_id=0)
SUITES = pytest.mark.parametrize("suite", list(Suite))
CONTROL_HEADER = bytes(14)


def key_for(suite):
    return None if suite is Suite.PLAIN else KEY


def make_client(suite=Suite.AESGCM, *, key=KEY, **options):
    return ClientConnection(HELLO, None if suite is Suite.PLAIN else key, suite, **options)


def make_server(suite=Suite.AESGCM, *, key=KEY, aes=True, **options):
    credential = Credential(None if suite is Suite.PLAIN else key)
    return ServerConnection(lambda name: credential, lambda hello: WELCOME, aes, **options)


def shake_hands(client, server):
    """Carry bytes both ways until neither has more to say."""
    client_events, server_events = [], server.receive_data(client.start())
    while to_client := server.data_to_send():
        client_events += client.receive_data(to_client)
        server_events += server.receive_data(client.data_to_send())
    return client_events, server_events


def established(suite=Suite.AESGCM, **options):
    client, server = make_client(suite, **options), make_server(suite, **options)
    (client_event,), (server_event,) = shake_hands(client, server)
    return client, server, client_event.keys, server_event.keys


def ready_to_accept(suite=Suite.AESGCM):
    client, server = make_client(suite), make_server(suite)
    server.receive_data(client.start())
    return client, server
