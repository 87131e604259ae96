"""A peer that holds the key and tries to change other nodes, or more, or at another time: nothing happens."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.link.foreign_proposals_helpers import rogue
from tests.support.bridge import happened
from tests.support.waiting import eventually
from tests.wire.document_helpers import documented_fields

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.protocol_error import Broken
from rsb_extras import node_control
from rsb_extras.node_control.change_records import (
    ChangeOutcome,
    ChangeStep,
    Component,
    Container,
    ListedGroup,
    Managed,
    ManagedNode,
    NodeChange,
)
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged
from rsb_extras.node_control.link_changes import AskManaged, ChangeEnded, ManagedAnswer, RunChange
from rsb_extras.node_control.node_changer import STARTS, ChangeCode
from rsb_extras.node_control.parameter_nodes import read_pages
from rsb_extras.node_control.parameter_records import (
    MOST_PARAMETERS,
    AskParameters,
    NewValue,
    NodeParameter,
    ParameterNode,
    ParametersAnswer,
    ParameterValue,
)
from rsb_extras.node_control.tests.control_places import ASKED_WITHIN, MANAGED_NAMES, TICKET_LIFE
from rsb_extras.node_control.tests.managed_nodes import ManagedNodes, has
from rsb_extras.node_control.tests.tuned_node import TunedNode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.rogue import Rogue

    from rsb_bridge.engine import Engine


@pytest.fixture
def nodes(pc: Domain) -> Iterator[ManagedNodes]:
    with closing(ManagedNodes(pc.id, "planner", "lidar")) as made:
        yield made


def start(bridge: Bridge) -> Engine:
    return bridge.server(features=has("nav", nav=("/planner",), all=("/planner", "/lidar")))


def ticket(peer: Rogue, request: int = 1) -> int:
    peer.say(AskManaged(request, ticket=True))
    return peer.wait_for(ManagedAnswer).ticket


def outcome(peer: Rogue, target: str, action: Any = "configure", number: int | None = None) -> ChangeOutcome:
    """Return the answer to a request with a number, or with a new ticket."""
    peer.say(RunChange(target, action, ticket=ticket(peer) if number is None else number, who="anna"))
    return peer.wait_for(ChangeEnded).outcome


def test_the_page_documents_each_field() -> None:
    page = Path(node_control.__file__).with_name("docs") / "node-control-protocol.md"
    kinds = (
        AskManaged, ManagedAnswer, RunChange, ChangeEnded, Managed, ManagedNode, ListedGroup, NodeChange, ChangeOutcome,
        Component, Container,
        ChangeStep, AskParameters, ParametersAnswer, ParameterNode, NodeParameter, ParameterValue, NewValue,
    )  # fmt: skip
    assert documented_fields(page.read_text(encoding="utf-8")) == {
        each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in kinds
    }


def test_what_it_may_not_change_is_refused(bridge: Bridge, nodes: ManagedNodes) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        for target in ("/lidar", "all", "none", "/", "//planner", "planner", "NAV", "-nav", "/planner/get_state"):
            assert outcome(peer, target).refused, target
        assert happened(server, ChangeCode.REFUSED, "/lidar: configure refused: the server does not let robot1")
    assert nodes.taken == []


@pytest.mark.parametrize(
    "broken",
    [
        {"target": ""}, {"target": "nav; reboot"}, {"target": "nav\0"}, {"target": "nav\n"}, {"target": "/" * 256},
        {"target": ["nav"]}, {"action": "destroy"}, {"action": ""}, {"action": 3}, {"who": "\x1b[2J"},
        {"who": "x" * 256}, {"ticket": -1}, {"ticket": 2**60}, {"ticket": "1"}, {"again": 1},
        {"values": [{"name": "a", "value": {"type": "table"}}]}, {"values": [{"name": "", "value": {}}]},
        {"values": [{"name": "a\x1b", "value": {}}]}, {"values": [{"name": "a", "value": {}}] * 201},
        {"values": [{"name": "a", "value": {"content": bytes(2**18 + 1)}}]}, {"values": [{"name": "a"}]},
    ],
)  # fmt: skip
def test_requests_out_of_bounds_end_the_link(bridge: Bridge, broken: dict[str, Any]) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        said = msgspec.to_builtins(RunChange("nav", "configure", ticket=ticket(peer)))
        peer.say_raw(msgspec.msgpack.encode(said | broken))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)
    assert not happened(server, ChangeCode.BEGAN)


def test_each_ticket_begins_one_change(bridge: Bridge, nodes: ManagedNodes) -> None:
    start(bridge)
    with rogue(bridge) as peer:
        numbers = [ticket(peer, request) for request in range(1, 6)]
        for number in (0, numbers[0], numbers[-1] + 1, 2**53):
            assert outcome(peer, "nav", number=number).refused, number
        assert nodes.taken == []
        peer.say(*[RunChange("nav", "configure", ticket=numbers[-1])] * 50)
        assert peer.wait_for(ChangeEnded).outcome.done
        assert outcome(peer, "nav", "cleanup", number=numbers[-1]).done, "the end of the one change"
    assert nodes.taken == [("planner", "configure")]


def test_a_ticket_of_another_connection_begins_nothing(bridge: Bridge, nodes: ManagedNodes) -> None:
    start(bridge)
    with rogue(bridge) as peer:
        number = ticket(peer)
    with rogue(bridge) as peer:
        for again in (False, True):
            peer.say(RunChange("nav", "configure", ticket=number, again=again))
            ended = peer.wait_for(ChangeEnded).outcome
            assert not ended.done
            assert ended.refused is not again, "asked again, it may have run before a restart"
    assert nodes.taken == []


def test_a_request_that_was_held_up_is_void(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    TICKET_LIFE.set(monkeypatch, 0.0)
    start(bridge)
    with rogue(bridge) as peer:
        assert outcome(peer, "nav").reason == "the request came too late, and nothing was done: ask again"


def test_few_changes_a_minute(bridge: Bridge, nodes: ManagedNodes) -> None:
    start(bridge)
    with rogue(bridge) as peer:
        refused = [outcome(peer, "nav", "cleanup").refused for _ in range(STARTS + 3)]
    assert refused == [False] * STARTS + [True] * 3


def test_answers_that_nobody_waits_for_do_nothing(bridge: Bridge) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        ticket(peer)
        peer.say(ManagedAnswer(7, 3), ChangeEnded(9, ChangeOutcome()), ChangeEnded(0, ChangeOutcome(reason="x")))
        assert ticket(peer, 2)
        assert server.snapshot().links[0].state is State.OK


def test_refused_requests_do_not_fill_the_log(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    ASKED_WITHIN.set(monkeypatch, 1e6)
    server = start(bridge)
    with rogue(bridge) as peer:
        assert all(outcome(peer, "none").refused for _ in range(STARTS + 8))
    assert sum(each.code == ChangeCode.REFUSED for each in server.events()) == STARTS


def test_a_forgotten_change_is_told_once_more(bridge: Bridge) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        numbers = [ticket(peer)]
        for _ in range(9):
            outcome(peer, "none", number=numbers[-1])
            numbers.append(ticket(peer))
        peer.say(RunChange("none", "up", ticket=numbers[0]), RunChange("none", "up", ticket=numbers[-1]))
        assert {peer.wait_for(ChangeEnded).ticket for _ in range(2)} == {numbers[0], numbers[-1]}
        assert server.snapshot().links[0].state is State.OK


def test_peers_that_see_no_node_have_none_asked(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[Any] = []

    async def look(context: Any) -> tuple[str, ...]:
        looks.append(context)
        return ()

    MANAGED_NAMES.set(monkeypatch, look)
    server = bridge.server(features={"show_nodes": False})
    with rogue(bridge) as peer:
        peer.say(AskManaged(1))
        assert peer.wait_for(ManagedAnswer).managed == Managed()
    assert looks == []
    server.do(ListManaged(here=True)).result(60)
    assert len(looks) == 1, "this side's operators have them asked"


def test_no_link_is_asked_for_this_sides_nodes(bridge: Bridge, nodes: ManagedNodes) -> None:
    server = start(bridge)
    with rogue(bridge, "node_control") as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        (side,) = server.do(ListManaged(here=True)).result(60)
        assert (side.link, [each.name for each in side.managed.groups]) == ("", ["nav", "all"])
        asked = server.do(ListManaged("robot1"))
        assert peer.wait_for(AskManaged).request == 1
        peer.say(ManagedAnswer(1))
        assert asked.result(60)[0].managed == Managed()


def test_a_ticket_that_a_peer_gives_twice_stands_for_one_change(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge, "node_control") as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        first = server.do(ChangeNodes("nav", "up", "robot1"))
        peer.say(ManagedAnswer(peer.wait_for(AskManaged).request, 7))
        assert peer.wait_for(RunChange).ticket == 7
        second = server.do(ChangeNodes("nav", "down", "robot1"))
        peer.say(ManagedAnswer(peer.wait_for(AskManaged).request, 7))
        with pytest.raises(EngineError, match="robot1 gave the same ticket twice, and nothing was done"):
            second.result(60)
        peer.say(ChangeEnded(7, ChangeOutcome()))
        assert first.result(60).done


@pytest.mark.parametrize(
    "broken",
    [
        {"node": "a b"}, {"node": "/a\x1b"}, {"names": [""]}, {"names": ["a"] * 101}, {"names": ["a\n"]},
        {"after": "x" * 256}, {"whole": 1}, {"request": -1},
    ],
)  # fmt: skip
def test_questions_out_of_bounds_end_the_link(bridge: Bridge, broken: dict[str, Any]) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        peer.say_raw(msgspec.msgpack.encode(msgspec.to_builtins(AskParameters(1, "/planner")) | broken))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)


def test_parameters_of_other_nodes_are_not_set(bridge: Bridge, pc: Domain) -> None:
    start(bridge)
    with closing(TunedNode(pc.id)) as node, rogue(bridge) as peer:
        eventually(lambda: "/controller" in {each.name for each in listed(peer).nodes}, what="the node")
        values = (NewValue("frame", ParameterValue.of("string", "odom")),)
        for target in ("/controller", "nav", "all"):
            peer.say(RunChange(target, "set", ticket=ticket(peer), who="anna", values=values))
            assert peer.wait_for(ChangeEnded).outcome.refused, target
        assert node["frame"] == "map"


def listed(peer: Rogue) -> ParametersAnswer:
    peer.say(AskParameters(1))
    return peer.wait_for(ParametersAnswer)


def test_pages_that_nobody_waits_for_do_nothing(bridge: Bridge) -> None:
    server = start(bridge)
    with rogue(bridge) as peer:
        ticket(peer)
        peer.say(ParametersAnswer(99, (NodeParameter("a"),)), ParametersAnswer(0, more=True))
        assert ticket(peer, 2)
        assert server.snapshot().links[0].state is State.OK


def test_a_peer_that_repeats_its_pages_is_not_asked_for_ever() -> None:
    asked: list[str] = []

    async def repeat(ask: AskParameters) -> ParametersAnswer:
        asked.append(ask.after)
        return ParametersAnswer(ask.request, (NodeParameter("b"), NodeParameter("a")), more=True)

    async def go_on(ask: AskParameters) -> ParametersAnswer:
        number = int(ask.after or 0) + 1
        return ParametersAnswer(ask.request, (NodeParameter(f"{number:09}"),), more=True)

    found = asyncio.run(read_pages(repeat, "/x", (), whole=False))
    assert ([each.name for each in found], asked) == (["a", "b"], ["", "b"])
    assert len(asyncio.run(read_pages(go_on, "/x", (), whole=False))) == MOST_PARAMETERS
