"""Proposals that this side does not understand, and ages that either side limits."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.link.foreign_proposals_helpers import link, rogue
from tests.support.bridge import happened, linked, now
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.rights import DeniedRemedy
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import ARMED
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Grant, Kind, Topic
from rsb_bridge.wire.messages import Accept, Amend, Propose, Refuse

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.purposes import Purpose

of_views = pytest.mark.skipif("view" not in purposes(), reason="the core alone")
KINDS: tuple[Kind, ...] = ("service", "action", "parameters")


def names(engine: Engine, side: str | None) -> set[tuple[str, str]]:
    return {(each.kind, each.topic) for each in engine.topics(side).result(60)}


def test_proposal_of_newer_side_is_refused_rest_stays(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge) as newer:
        ask: dict[str, Any] = {"topic": "/thought", "remote_topic": "/thought", "from_client": True}
        newer.say(Propose(route=1, kind="telepathy", **ask), Propose(route=3, kind="topic", **ask))
        refused = newer.wait_for(Refuse, Accept)
        assert isinstance(refused, Refuse)
        assert (refused.route, refused.code) == (1, "denied")
        assert "telepathy" in refused.reason
        assert "update" in refused.reason
        assert newer.wait_for(Accept).route == 3
        assert linked(server)
        assert happened(server, EventCode.ROUTE_REFUSED, "telepathy")


@pytest.mark.parametrize("change", [{"timeout": 5.0}, {"kind": "service", "transport": "udp"}])
def test_fields_of_other_kinds_are_refused(bridge: Bridge, change: dict[str, Any]) -> None:
    bridge.server()
    with rogue(bridge) as client:
        asked = Propose(route=1, topic="/add", remote_topic="/add", from_client=True)
        client.say(msgspec.structs.replace(asked, **change))
        refused = client.wait_for(Refuse, Accept)
        assert isinstance(refused, Refuse)
        assert refused.code == "denied"


def test_max_age_holds_for_what_either_side_proposes(bridge: Bridge) -> None:
    """The server's session sets it, the client proposes the topic."""
    topic = Topic("/scan", "transmit", max_age=0.5)
    server = bridge.server(key_file=None, clients=(Client("robot1", key_file=bridge.key_file, topics=(topic,)),))
    with rogue(bridge) as client:
        assert client.wait_for(Propose).max_age == 0.5
        client.say(Propose(route=1, topic="/scan", remote_topic="/scan", from_client=True, max_age=2.0))
        assert client.wait_for(Accept).max_age == 0.5
        (mine,) = link(server).routes.values()
        assert mine.age.max_age == 0.5
        client.say(Amend(1, max_age=0.2))
        eventually(lambda: mine.age.max_age == 0.2)
        client.say(Amend(1, max_age=0.0))
        eventually(lambda: mine.age.max_age == 0.5)


def test_what_has_to_be_armed_has_max_age(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge) as client:
        client.say(Propose(route=1, topic="/cmd", remote_topic="/cmd", from_client=True, arm=True))
        client.wait_for(Accept)
        (mine,) = link(server).routes.values()
        assert mine.age.max_age == ARMED
        client.say(Amend(1, max_age=0.0))
        eventually(lambda: not mine.age.is_on)


REFUSED: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("view", {}, "look"),
    ("view", {"from_client": False, "topic": "/scan", "remote_topic": "/scan"}, "/scan"),
    ("view", {"from_client": False, "remote_topic": "view/2"}, "view/2"),
    ("view", {"from_client": False, "topic": "bench/1", "remote_topic": "bench/1"}, "bench/1"),
    ("view", {"from_client": False, "type": "std_msgs/msg/String"}, "type"),
    ("view", {"from_client": False, "type": ""}, "type"),
    ("view", {"from_client": False, "arm": True}, "arm"),
    ("view", {"from_client": False, "max_age": 1.0}, "max_age"),
    ("view", {"from_client": False, "kind": "service"}, "kind"),
    ("view", {"from_client": False, "qos": Qos(durability="transient_local")}, "late joiners"),
    ("view", {"from_client": False, "transport": "bluetooth"}, "protocol"),
    ("view", {"from_client": False, "purpose": "topic"}, "absolute"),
    ("view", {"from_client": False, "purpose": "telepathy"}, "update"),
)
"""What a peer changes in the proposal of an internal route, and what the refusal names."""


@of_views
def test_an_internal_route_has_its_own_rules(bridge: Bridge) -> None:
    """It becomes no topic under any name, and a topic becomes none."""
    server = bridge.server()
    with rogue(bridge) as client:
        numbers = itertools.count(1, 2)

        def answer_to(purpose: Purpose, change: dict[str, Any]) -> object:
            name = purpose.route_name("1")
            asked = Propose(
                route=next(numbers), topic=name, remote_topic=name, from_client=True, type=purpose.type_name
            )
            client.say(msgspec.structs.replace(asked, **{"purpose": purpose.name} | change))
            return client.wait_for(Refuse, Accept)

        for purpose, change, words in REFUSED:
            answer = answer_to(purposes()[purpose], change)
            assert isinstance(answer, Refuse), change
            assert answer.code == "denied"
            assert words in answer.reason
        assert not link(server).routes
        assert isinstance(answer_to(purposes()["view"], {"from_client": False}), Accept)
        assert now(server).routes == (), "operators see no view as a topic"


@of_views
def test_a_view_needs_a_right_to_look(bridge: Bridge) -> None:
    client_entry = Client("robot1", key_file=bridge.key_file, allow=(Grant("/cmd_vel", may="publish"),))
    bridge.server(key_file=None, clients=(client_entry,))
    with rogue(bridge) as client:
        asked = Propose(route=1, topic="view/1", remote_topic="view/1", from_client=False, purpose="view")
        client.say(msgspec.structs.replace(asked, type=purposes()["view"].type_name))
        refused = client.wait_for(Refuse, Accept)
        assert isinstance(refused, Refuse)
        assert says(refused.reason, DeniedRemedy.ADD_LOOK)
