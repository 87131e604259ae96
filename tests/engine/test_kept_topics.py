"""Topics that an operator adds on a server are kept in its session, and proposed to the client whenever it links."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace
from tests.support.bridge import Bridge, carries, find, happened, heard, linked, now, route
from tests.support.domain import Domain, text
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import load_file, save
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

CHAT = Topic("/chat", "transmit")


def test_kept_topic_returns_when_either_side_restarts(
    bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path
) -> None:
    """Saved to a file that listed no clients, and loaded from it."""
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    path = tmp_path / "pc.yaml"
    save(bridge.server_session(), path)
    opened = load_file(path)
    server = bridge.start(opened.session)
    assert server.session == opened.session
    client = bridge.client()
    server.add_topic(CHAT).result(60)
    carries([out], server, ["/chat"])
    assert server.session.clients == (Client("robot1", topics=(CHAT,)),)
    assert client.session.topics == (), "the client's file is not concerned"
    save(server.session, path, opened)

    client.stop()
    eventually(lambda: not linked(server))
    eventually(lambda: not out.get_subscription_count(), what="the subscription of the one that is gone is, too")
    bridge.client()
    carries([out], server, ["/chat"])
    out.publish(text("after the client"))
    heard(there, 1)

    server.stop()
    bridge.move()
    client.stop()
    eventually(lambda: not out.get_subscription_count())
    server = bridge.start(replace(load_file(path).session, server_port=bridge.port))
    bridge.client()
    carries([out], server, ["/chat"])
    out.publish(text("after the server"))
    assert heard(there, 2) == [text("after the client"), text("after the server")]
    assert server.session.clients == (Client("robot1", topics=(CHAT,)),)


def test_each_client_has_its_own_kept_topics(bridge: Bridge) -> None:
    clients = (Client("robot1", allow=("/chat",)), Client("robot2", topics=(Topic("/map", "transmit"),)))
    server = bridge.server(clients=clients, shared_keys=True)
    assert server.session.clients == clients
    server.add_topic(CHAT, "robot1").result(60)
    assert server.session.clients == (replace(clients[0], topics=(CHAT,)), clients[1])


def test_two_different_entries_are_refused_with_lines(bridge: Bridge, robot: Domain, tmp_path: Path) -> None:
    robot.publisher("/chat")
    clients = (Client("robot1", topics=(replace(CHAT, protocol="udp"),)),)
    server, client = bridge.server(clients=clients), bridge.client(Topic("/map", "transmit"), CHAT)
    for engine, name in ((server, "pc.yaml"), (client, "robot1.yaml")):
        save(engine.session, tmp_path / name)
        engine.use_file(tmp_path / name)
    for engine in (server, client):
        for place in ("topics[1] of robot1.yaml", "clients[0].topics[0] of pc.yaml"):
            eventually(lambda engine=engine, place=place: place in route(engine, "/chat").reason)
        shown = route(engine, "/chat")
        assert (shown.state, shown.cause) == (State.DOWN, Cause.LISTED_DIFFERENTLY)
        eventually(
            lambda engine=engine: (
                [each.cause for each in now(engine).routes if each.topic != "/chat"] == [Cause.NO_PUBLISHER]
            )
        )
    assert server.session.clients == clients
    assert client.session.topics == (Topic("/map", "transmit"), CHAT)
    client.remove_topic(route(client, "/chat").key).result(60)
    eventually(lambda: find(client, "/chat") and route(client, "/chat").transport == "udp")
    assert list(client.session.topics) == [Topic("/map", "transmit")]
    server.remove_topic(route(server, "/chat").key).result(60)
    assert server.session.clients == (Client("robot1"),), "removed by an operator"


def test_what_client_refuses_is_said_on_both_sides(bridge: Bridge) -> None:
    halt = Topic("/halt", "receive")
    server = bridge.server(clients=(Client("robot1", topics=(halt,)),), shutdown_topic=None)
    client = bridge.client(shutdown_topic="/halt", allow=("/halt",))
    # It is tried again, and there is no reason to show meanwhile.
    reason = Denied.SHUTDOWN_TOPIC(topic="/halt")
    eventually(lambda: reason in route(server, "/halt").reason)
    assert happened(client, EventCode.ROUTE_REFUSED, f"/halt: {reason}")
    assert find(client, "/halt") is None
    assert server.session.clients == (Client("robot1", topics=(halt,)),)


def test_topic_has_name_that_servers_screen_shows(bridge: Bridge) -> None:
    """With `use_name`, in every command; the client's own name does as well."""
    bridge.make_key("other")
    server = bridge.server(clients=(Client("robot1", use_name=True), Client("robot2", key_file="other.key")))
    client = bridge.client(allow=("/*",))
    eventually(lambda: linked(server))
    keys = [server.add_topic(Topic(name, "transmit")).result(60) for name in ("/robot1/chat", "/robot1/map")]
    server.add_topic(Topic("/scan", "transmit"), "robot1").result(60)
    both = Topic("/robot1/odom", "receive", remote_topic="/robot1/odom")
    server.add_topic(both, "robot1").result(60)
    eventually(lambda: all(find(client, name) for name in ("/chat", "/map", "/scan", "/robot1/odom")))
    for name in ("/robot1/chat", "/robot1/map", "/robot1/scan", "/robot1/odom"):
        assert find(server, name)
    assert happened(server, EventCode.OPERATOR_ADDED, "/robot1/chat: added by ")

    server.edit_topic(keys[0], Topic("/robot1/words", "transmit")).result(60)
    eventually(lambda: find(client, "/words") and find(server, "/robot1/words") and not find(client, "/chat"))
    server.edit_topic(route(server, "/robot1/odom").key, replace(both, max_rate=5.0)).result(60)
    names = [topic.topic for topic in server.session.listed_clients[0].topics]
    assert names == ["/words", "/map", "/scan", "/robot1/odom"]
    with pytest.raises(EngineError, match=pattern(Denied.WHICH_CLIENT, clients="robot1, robot2")):
        server.add_topic(Topic("/tf", "transmit")).result(60)
