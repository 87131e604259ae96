"""Operators' commands while the bridge runs, from either side, and recoveries of the bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import pytest
from std_msgs.msg import String
from tests.support.bridge import carries, happened, heard, linked, route
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.control.protocol import AnyCommand
from rsb_bridge.installed_features import installed
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import Restart, Stop, acting
from rsb_bridge.model.session import Topic
from rsb_bridge.model.type_names import TypeNameProblem
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine


@pytest.mark.parametrize("operator", ["client", "server"])
def test_topics_are_added_edited_paused_and_removed(operator: str, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """From either side; the session that a client would save follows."""
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both()
    engine = client if operator == "client" else server
    key = engine.add_topic(Topic("/chat", "transmit")).result(60)
    carries([out], server, ["/chat"])
    out.publish(text("tcp"))
    assert heard(there, 1) == [text("tcp")]
    with pytest.raises(EngineError, match=pattern(Denied.EDIT_THAT_ROUTE, topic="/chat")):
        engine.add_topic(Topic("/chat", "transmit")).result(60)
    with pytest.raises(EngineError, match=pattern(TypeNameProblem.SHORT_NAME_MISSPELT, name="LaserScam")):
        engine.edit_topic(key, Topic("/chat", "transmit", type="LaserScam")).result(60)

    edited = Topic("/chat", "transmit", protocol="udp", qos=3)
    key = engine.edit_topic(key, edited, seen=Topic("/chat", "transmit")).result(60)
    with pytest.raises(EngineError, match=pattern(Denied.CHANGED, topic="/chat")):
        engine.edit_topic(key, Topic("/chat", "transmit", max_rate=5.0), seen=Topic("/chat", "transmit")).result(60)
    eventually(lambda: route(server, "/chat").transport == route(client, "/chat").transport == "udp")
    carries([out], server, ["/chat"])
    out.publish(text("udp"))
    heard(there, 2)

    for side in (client, server):
        side.pause(route(side, "/chat").key, True).result(60)
        eventually(lambda: {route(each, "/chat").state for each in (client, server)} == {"paused"})
        eventually(lambda: not out.get_subscription_count())
        side.pause(route(side, "/chat").key, False).result(60)
        carries([out], server, ["/chat"])
    out.publish(text("resumed"))
    assert heard(there, 3) == [text("tcp"), text("udp"), text("resumed")]
    ours = (Topic("/chat", "transmit", protocol="udp", qos=3),)
    assert client.session.topics == (ours if operator == "client" else ())

    engine.remove_topic(key).result(60)
    eventually(lambda: not client.snapshot().routes and not server.snapshot().routes)
    eventually(lambda: not out.get_subscription_count() and not there.matched)
    with pytest.raises(EngineError, match=pattern(Denied.NO_ROUTE)):
        engine.remove_topic(key).result(60)


def test_the_other_sides_topics(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    robot.publisher("/odom", qos=LATCHED)
    pc.listener("/goal")
    server, client = bridge.both()

    def names(engine: Engine, link: str | None) -> dict[str, Any]:
        return {each.topic: each for each in engine.topics(link).result(60)}

    for engine, own, others in ((server, None, "robot1"), (client, "robot1", None)):
        eventually(lambda engine=engine, own=own: "/goal" in names(engine, own))
        eventually(lambda engine=engine, others=others: "/odom" in names(engine, others))
        odom = names(engine, others)["/odom"]
        assert (odom.type_name, odom.publishers, odom.subscriptions) == ("std_msgs/msg/String", 1, 0)
        assert odom.qos.durability == "transient_local"
        assert odom.type_hash.startswith("RIHS01_")
        assert names(engine, own)["/goal"].qos is None
    client.stop()
    eventually(lambda: not linked(server))
    with pytest.raises(EngineError, match=pattern(Denied.NOT_LINKED, name="robot1")):
        server.topics("robot1").result(60)


def test_edited_topic_keeps_its_place(bridge: Bridge) -> None:
    """A save finds the topic's lines in the file, even if its name has changed."""
    _, client = bridge.both(*(Topic(name, "transmit") for name in ("/a", "/b", "/c")))
    client.edit_topic(route(client, "/b").key, Topic("/b2", "receive")).result(60)
    assert [topic.topic for topic in client.session.topics] == ["/a", "/b2", "/c"]
    with pytest.raises(EngineError, match=pattern(NameMistake.NOT_ABSOLUTE, noun="topic")):
        client.edit_topic(route(client, "/a").key, Topic("a", "transmit")).result(60)
    assert [topic.topic for topic in client.session.topics] == ["/a", "/b2", "/c"]


def test_prefix_beyond_name_length_is_refused(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """For topics of both sides, and `use_name` in either side's file."""
    long = "/" + "a" * 245
    server, client = bridge.server(use_name=True), bridge.client(Topic(long, "transmit"), Topic("/b", "transmit"))
    eventually(lambda: linked(client) and linked(server), what="linked")
    eventually(lambda: says(route(client, long).reason, NameMistake.NAME_TOO_LONG, length=253))
    eventually(lambda: happened(server, EventCode.ROUTE_REFUSED, NameMistake.NAME_TOO_LONG, length=253))
    with pytest.raises(EngineError, match=pattern(NameMistake.NAME_TOO_LONG_WITH_PREFIX, length=254)):
        server.add_topic(Topic("/" + "c" * 246, "receive")).result(60)
    assert not happened(client, EventCode.LINK_LOST)
    eventually(lambda: route(client, "/b").stages[5].done, what="accepted")
    bridge.close()
    bridge.move()
    _, client = bridge.both(Topic("/b", "transmit"), use_name=True)
    with pytest.raises(EngineError, match=pattern(NameMistake.NAME_TOO_LONG_WITH_PREFIX, length=254)):
        client.add_topic(Topic("/" + "c" * 246, "transmit")).result(60)
    assert linked(client)


def shut_down_there(client: Engine, server: Engine) -> None:
    """Both sides say that an operator of the server has shut the link down, and that the client asks again."""

    def said(engine: Engine) -> bool:  # a snapshot is a moment old, and an attempt may be running
        (link,) = engine.snapshot().links
        return (link.state, link.cause) == ("down", LinkCause.SHUT_DOWN) and bool(link.retry_in)

    eventually(lambda: said(client) and said(server))


@pytest.mark.parametrize("restarts", [True, False])
def test_link_shut_down_before_its_client_came(restarts: bool, bridge: Bridge) -> None:
    server = bridge.server()
    with acting("anna on pts/3"):
        server.shut_down().result(60)
    client = bridge.client()
    eventually(lambda: client.snapshot().links[0].cause == LinkCause.SHUT_DOWN)
    for engine in (client, server):
        assert "anna on pts/3" in engine.snapshot().links[0].reason
    (server.restart() if restarts else server.retry("robot1")).result(60)
    client.retry().result(60)
    eventually(lambda: linked(client) and linked(server))


@pytest.mark.parametrize("side", ["client", "server"])
def test_the_shutdown_topic(side: str, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Closes the sockets on both sides. The side on whose topic it was published keeps the link down.

    A client waits for its operator; a server takes the next init as it is then. A server refuses the client, which
    does not end, until it is to let it in again.
    """
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])
    stop = (robot if side == "client" else pc).publisher("/shutdown")
    eventually(stop.get_subscription_count)
    stop.publish(text("not this"))
    stop.publish(String(data="shutdown"))
    eventually(lambda: not linked(server) and not linked(client))
    engine = client if side == "client" else server
    eventually(lambda: happened(engine, EventCode.ENGINE_SHUTDOWN))
    code = EventCode.LINK_SHUT_DOWN if side == "server" else EventCode.LINK_CLOSED_BY_PEER
    eventually(lambda: happened(server, code))
    holds(lambda: not linked(server) and client.waits_for_operator == (side == "client"), 1.5)
    if side == "server":
        shut_down_there(client, server)
        client.retry().result(60)
        eventually(lambda: server.snapshot().links[0].attempts)  # it has asked, and has been refused
        shut_down_there(client, server)
        server.retry().result(60)
    client.retry().result(60)
    eventually(lambda: linked(client) and linked(server))
    assert not client.waits_for_operator
    carries([out], server, ["/chat"])
    out.publish(text("again"))
    assert heard(there, 1) == [text("again")]


def test_a_shutdown_while_calling(bridge: Bridge) -> None:
    """A client that is to stay down does not call again, though it was between two attempts."""
    client = bridge.client()
    eventually(lambda: happened(client, EventCode.LINK_UNREACHABLE))
    client.shut_down().result(60)
    bridge.server()
    eventually(lambda: client.waits_for_operator)
    holds(lambda: not linked(client), 2.0)
    client.retry().result(60)
    eventually(lambda: linked(client))


@pytest.mark.parametrize("operator", ["client", "server"])
def test_restarting(operator: str, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"), Topic("/own", "transmit", protocol="udp"))
    carries([out], server, ["/chat"])
    steps: list[str] = []
    (client if operator == "client" else server).restart(steps.append).result(60)
    assert steps[-1] == ("2 of 2 topics and services accepted" if operator == "client" else "1 client is back")
    carries([out], server, ["/chat"])
    out.publish(text("again"))
    assert heard(there, 1) == [text("again")]


def test_every_command_has_a_handler(bridge: Bridge) -> None:
    engine = bridge.client()
    running = inside(engine)
    assert running is not None
    observers = [each for feature in installed() for each in feature.observers(engine)]
    elsewhere = {Restart, Stop}.union(*(each.answers for each in observers))
    assert running.handlers.keys() | elsewhere == set(get_args(AnyCommand))
