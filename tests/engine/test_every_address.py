"""A server on ``::`` is reached over IPv4 and IPv6, by both transports; a client names the address that it uses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import carries, linked
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("address", ["127.0.0.1", "::1"])
def test_server_on_every_address_hears(bridge: Bridge, robot: Domain, pc: Domain, protocol: Any, address: str) -> None:
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    server = bridge.server(server_ip="::")
    client = bridge.client(Topic("/chat", "transmit", protocol=protocol), server_ip=address)
    eventually(lambda: linked(server) and linked(client))
    carries([publisher], server, ["/chat"])
    publisher.publish(text("x"))
    eventually(lambda: listener.payloads)


def test_client_names_the_address_in_use(bridge: Bridge) -> None:
    server = bridge.server()
    client = bridge.client(server_ip=("127.0.0.2", "127.0.0.1"))  # nobody listens at the first one
    eventually(lambda: linked(server) and linked(client))
    eventually(lambda: client.snapshot().address == f"127.0.0.1:{bridge.port}")
