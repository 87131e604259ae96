"""Operators acknowledge faults: the engine keeps it, for all consoles, until the fault changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import linked
from tests.support.waiting import eventually, holds

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.control import Machine


def test_acknowledged_fault_is_known_in_all_consoles(bridge: Bridge, machine: Machine) -> None:
    client = bridge.client(Topic("/chat", "transmit"))
    eventually(lambda: client.snapshot().links[0].state is State.DOWN, what="a link that is down")
    machine.serve(client)
    one, other = machine.attach(), machine.attach()

    def is_known(*, known: bool = True) -> bool:
        snapshots = [each.snapshot() for each in (client, one, other)]
        links = [link.acknowledged for now in snapshots for link in now.links]
        routes = [route.acknowledged for now in snapshots for route in now.routes]
        return all((each is not None) is known for each in (*links, *routes))

    with acting("anna"):
        client.acknowledge("", link="robot1").result(60)
    eventually(is_known, what="marked everywhere, the topic that is down with the link, too")
    record = other.snapshot().links[0].acknowledged
    assert record is not None
    assert record.by == "anna"
    holds(is_known, 3.0)  # attempts go on meanwhile
    one.acknowledge(one.snapshot().routes[0].key, False).result(60)  # the topic's fault is the link's
    eventually(lambda: is_known(known=False), what="counted again")
    with pytest.raises(EngineError):
        one.acknowledge("", False, link="robot1").result(60)
    with pytest.raises(EngineError):
        one.acknowledge("", link="robot2").result(60)
    with pytest.raises(EngineError):
        one.acknowledge("", link="robot1", seen=(State.STALE, "")).result(60)
    with pytest.raises(EngineError):  # though its fault is the link's, which is another one
        one.acknowledge(one.snapshot().routes[0].key, seen=(State.SLOW, "slow")).result(60)
    one.acknowledge("", link="robot1").result(60)
    eventually(is_known, what="marked again")

    watching = machine.attach(read_only=True)
    with pytest.raises(EngineError):
        watching.acknowledge("", False, link="robot1").result(60)
    assert is_known()

    bridge.server()
    eventually(lambda: linked(client), what="linked")
    eventually(lambda: is_known(known=False), what="the fault is over")
    with pytest.raises(EngineError):
        one.acknowledge("", link="robot1").result(60)
    acknowledged = [each for each in client.events() if each.code == EventCode.OPERATOR_ACKNOWLEDGED]
    assert [(each.link, each.topic) for each in acknowledged] == [("robot1", "")] * 2
    assert acknowledged[0].who == "anna"
    undone = [each for each in client.events() if each.code == EventCode.OPERATOR_ACKNOWLEDGEMENT_UNDONE]
    assert len(undone) == 1
