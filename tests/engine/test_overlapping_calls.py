"""A service that is bridged already is not bridged a second time on request."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support.bridge import find, route
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine

NODE = Topic("/n", "transmit", kind="parameters")
SETTER = Topic("/n/set_parameters", "transmit", kind="service")
DOCK = Topic("/dock", "transmit", kind="action")
GOAL = Topic("/dock/_action/send_goal", "transmit", kind="service")


def test_it_is_not_added_on_either_side(bridge: Bridge) -> None:
    server, client = engines = bridge.both()
    back = msgspec.structs.replace(SETTER, direction="receive")
    for first, second in ((NODE, SETTER), (SETTER, NODE), (SETTER, back)):
        key = client.add_topic(first).result(30)
        for engine in engines:
            eventually(lambda engine=engine, first=first: find(engine, first.topic))
        for engine in engines:
            with pytest.raises(EngineError) as refusal:
                engine.add_topic(second, link="robot1").result(30)
            assert first.topic in str(refusal.value)
            assert second.topic in str(refusal.value)
        assert all(len(engine.snapshot().routes) == 1 for engine in engines)
        client.remove_topic(key).result(30)
        eventually(lambda: not server.snapshot().routes)


def test_nor_by_an_edit(bridge: Bridge) -> None:
    other = Topic("/m/set_parameters", "transmit", kind="service")
    server, client = bridge.both(NODE, other)
    eventually(lambda: find(server, other.topic))
    with pytest.raises(EngineError) as refusal:
        client.edit_topic(route(client, other.topic).key, SETTER).result(30)
    assert NODE.topic in str(refusal.value)
    assert {each.topic for each in client.snapshot().routes} == {NODE.topic, other.topic}
    eventually(lambda: {each.topic for each in server.snapshot().routes} == {NODE.topic, other.topic})


def test_both_sides_tell_of_two_entries(bridge: Bridge) -> None:
    """Neither knew of the other's when it took its own."""
    server = bridge.server()
    server.add_topic(SETTER, link="robot1").result(30)
    client = bridge.client(NODE)
    for engine, own, others in ((server, SETTER, NODE), (client, NODE, SETTER)):

        def refusal(engine: Engine = engine, own: Topic = own) -> str:
            found = route(engine, own.topic)  # it is tried again, and there is no reason to show meanwhile
            return found.reason if found.cause == "refused" else ""

        reason = eventually(refusal)
        assert others.topic in reason
        assert own.topic in reason
