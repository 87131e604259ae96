"""Rights to call and to serve on real links: refused on both sides with a reason, changed by a reload."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
from tests.calls.ledgers import AT_ONCE, called, counts, nothing_left
from tests.support.bridge import find, happened, reloaded, route
from tests.support.waiting import eventually

from rsb_bridge.config.rights import DeniedText
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Grant, Topic

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode


def of_the_robot(name: str) -> Topic:
    return Topic(name, "receive", kind="service")


def test_server_calls_only_what_robots_file_lists(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    """Both sides say what would allow it; the client's operator may list it while the bridge runs."""
    near.serve(service)
    server, client = bridge.both()
    server.add_topic(of_the_robot(service)).result(60)
    eventually(lambda: route(server, service).cause == "refused")
    listing = "list it under services in the session file of robot1, with provider: client"
    assert listing in route(server, service).reason
    assert happened(
        client,
        EventCode.ROUTE_REFUSED,
        DeniedText.NOT_ALLOWED,
        owner="robot1",
        peer="the server",
        use=f"service {service}",
    )
    assert find(client, service) is None
    assert not far.ready(service)

    client.add_topic(of_the_robot(service)).result(60)
    far.waits_for(service)
    assert far.call(service, 5).right
    nothing_left(server, client)


def test_client_calls_and_serves_what_server_allows(
    bridge: Bridge, near: CallNode, far: CallNode, service: str, tmp_path: Path
) -> None:
    """A right to all topics is no right to call; a reload grants it, limits it and ends it."""
    file, key = tmp_path / "pc.yaml", "robot1.key"
    far.serve(service)
    server = bridge.server(clients=(Client("robot1", key_file=key, allow=("/*",)),))
    client = bridge.client(called(service))
    eventually(lambda: route(client, service).cause == "refused")
    add = f"add {{services: {service}, may: call}} to allow of client robot1 in the session file of"
    assert add in route(client, service).reason

    allowing = Grant(services=f"{service}*", may="call")
    reloaded(server, file, clients=(Client("robot1", key_file=key, allow=("/*", allowing)),))
    near.waits_for(service)
    assert near.call(service, 5).right

    slow = msgspec.structs.replace(allowing, max_rate=1.0)
    reloaded(server, file, clients=(Client("robot1", key_file=key, allow=("/*", slow)),))
    eventually(lambda: route(client, service).max_rate == 1.0)
    near.begin(service, 10, at_once=10)
    eventually(lambda: sum(counts(client, service).refused.values()) >= 5)
    near.give_up(service)

    serving = Client("robot1", key_file=key, allow=(allowing,), deny=(Grant(services=service, may="call"),))
    changed = reloaded(server, file, clients=(serving,)).changed
    assert any(f"{service} may not cross any more" in change for change in changed)
    near.waits_for_none(service, AT_ONCE)
    assert find(server, service) is None
    client.add_topic(of_the_robot(f"{service}/other")).result(60)
    eventually(lambda: route(client, f"{service}/other").cause == "refused")
    assert "may: serve" in route(client, f"{service}/other").reason
    nothing_left(server, client)
