"""Sides of which one can do more than the other: what they say of it, and what they do not even ask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support.bridge import happened, linked, route
from tests.support.inside import inside
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import read_key
from rsb_bridge.model.calls import FEATURE
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import ARMED
from rsb_bridge.model.limits import LATE_AFTER_FEATURE, MAX_AGE_FEATURE
from rsb_bridge.model.session import Client, Kind, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.messages import Accept, Amend, ListTopics, Ping, Pong, Propose, Provide, Refuse, TopicList

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link

KINDS: tuple[Kind, ...] = ("service", "action", "parameters")


def rogue(bridge: Bridge, *, features: tuple[str, ...] = (FEATURE,)) -> Rogue:
    return Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret, features=features)


def link(engine: Engine) -> Link:
    return inside(engine).links()[0]


def names(engine: Engine, side: str | None) -> set[tuple[str, str]]:
    return {(each.kind, each.topic) for each in engine.topics(side).result(60)}


def test_both_sides_say_that_they_carry_calls(bridge: Bridge) -> None:
    server, client = bridge.both()
    assert FEATURE in link(server).features
    assert FEATURE in link(client).features


def test_only_topics_are_proposed_to_an_older_client(bridge: Bridge) -> None:
    """The routes show the remedy, and come with its update."""
    called = [Topic(f"/{kind}", "transmit", kind=kind) for kind in KINDS]
    server = bridge.server(
        key_file=None,
        clients=(Client("robot1", key_file=bridge.key_file, topics=(*called, Topic("/scan", "receive"))),),
    )
    with rogue(bridge, features=()) as older:
        eventually(lambda: linked(server))
        eventually(lambda: all(route(server, f"/{kind}").cause == "refused" for kind in KINDS))
        for kind in KINDS:
            found = route(server, f"/{kind}")
            assert found.state is State.DOWN
            assert "update" in found.reason
        proposed = older.wait_for(Propose)
        assert (proposed.kind, proposed.topic) == ("topic", "/scan")
        older.say(Ping(1, 1))
        assert isinstance(older.wait_for(Pong, Propose, Provide), Pong)
    eventually(lambda: not linked(server))
    with rogue(bridge) as newer:
        assert {newer.wait_for(Propose).kind for _ in range(4)} == {"topic", *KINDS}


def test_what_only_a_newer_side_can_propose_is_refused_and_the_rest_goes_on(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge, features=(FEATURE, "telepathy")) as newer:
        ask: dict[str, Any] = {"topic": "/thought", "remote_topic": "/thought", "from_client": True}
        newer.say(Propose(route=1, kind="telepathy", **ask), Propose(route=3, kind="topic", **ask))
        refused = newer.wait_for(Refuse, Accept)
        assert isinstance(refused, Refuse)
        assert (refused.route, refused.code) == (1, "denied")
        assert "telepathy" in refused.reason
        assert "update" in refused.reason
        assert newer.wait_for(Accept).route == 3
        assert linked(server)
        assert "telepathy" in link(server).features
        assert happened(server, EventCode.ROUTE_REFUSED, "telepathy")


@pytest.mark.parametrize("change", [{"timeout": 5.0}, {"kind": "service", "transport": "udp"}])
def test_what_a_kind_does_not_have_is_refused_in_words(bridge: Bridge, change: dict[str, Any]) -> None:
    bridge.server()
    with rogue(bridge) as client:
        asked = Propose(route=1, topic="/add", remote_topic="/add", from_client=True)
        client.say(msgspec.structs.replace(asked, **change))
        refused = client.wait_for(Refuse, Accept)
        assert isinstance(refused, Refuse)
        assert refused.code == "denied"


def test_an_older_client_is_told_of_topics_only(bridge: Bridge, pc: Domain) -> None:
    from std_srvs.srv import Trigger

    pc.publisher("/status")
    pc.serve("/reset", Trigger)
    server = bridge.server()
    eventually(lambda: names(server, None) >= {("topic", "/status"), ("service", "/reset")})
    with rogue(bridge, features=()) as older:
        older.say(ListTopics(request=1), ListTopics(request=2, kinds=("telepathy", "service")))
        topics = older.wait_for(TopicList).topics
        assert "/status" in {each.topic for each in topics}
        assert {each.kind for each in topics} == {"topic"}
        assert ("/reset", "service") in {(each.topic, each.kind) for each in older.wait_for(TopicList).topics}


@pytest.mark.parametrize("features", [(), (LATE_AFTER_FEATURE,)])
def test_a_limit_that_an_older_client_would_ignore_is_refused_in_words(
    bridge: Bridge, features: tuple[str, ...]
) -> None:
    server = bridge.server()
    with rogue(bridge, features=features) as client:
        client.say(Propose(route=1, topic="/scan", remote_topic="/scan", from_client=True))
        assert isinstance(client.wait_for(Accept, Refuse), Accept)
        found = route(server, "/scan")
        late = msgspec.structs.replace(found.spec, late_after=2.0)
        if features:
            server.edit_topic(found.key, late).result(60)
            assert client.wait_for(Amend).late_after == 2.0
        else:
            with pytest.raises(EngineError, match="update"):
                server.edit_topic(found.key, late).result(60)
            assert happened(server, EventCode.OPERATOR_EDITED) is None
            server.edit_topic(found.key, msgspec.structs.replace(found.spec, max_rate=5.0)).result(60)
            assert client.wait_for(Amend).max_rate == 5.0


@pytest.mark.parametrize("features", [(), (MAX_AGE_FEATURE,)])
def test_max_age_holds_for_what_either_side_proposes(bridge: Bridge, features: tuple[str, ...]) -> None:
    """The server's session sets it, the client proposes the topic; an older client leaves the server to it alone."""
    topic = Topic("/scan", "transmit", max_age=0.5)
    server = bridge.server(key_file=None, clients=(Client("robot1", key_file=bridge.key_file, topics=(topic,)),))
    with rogue(bridge, features=features) as client:
        assert client.wait_for(Propose).max_age == 0.5
        client.say(Propose(route=1, topic="/scan", remote_topic="/scan", from_client=True, max_age=2.0))
        assert client.wait_for(Accept).max_age == 0.5
        (mine,) = link(server).routes.values()
        assert mine.age.max_age == 0.5
        if features:
            client.say(Amend(1, max_age=0.2))
            eventually(lambda: mine.age.max_age == 0.2)
            client.say(Amend(1, max_age=0.0))
            eventually(lambda: mine.age.max_age == 0.5)
        else:
            eventually(lambda: happened(server, EventCode.ROUTE_MAX_AGE_ONE_SIDED))


def test_what_has_to_be_armed_has_a_max_age(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge, features=(MAX_AGE_FEATURE,)) as client:
        client.say(Propose(route=1, topic="/cmd", remote_topic="/cmd", from_client=True, arm=True))
        client.wait_for(Accept)
        (mine,) = link(server).routes.values()
        assert mine.age.max_age == ARMED
        client.say(Amend(1, max_age=0.0))
        eventually(lambda: not mine.age.is_on)
