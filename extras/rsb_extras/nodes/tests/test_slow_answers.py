"""Nodes over a thin line: a late answer counts, old ones are not shown as of now, and faults are not cut."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import zstandard
from msgspec.structs import replace
from tests.console.driving import NARROW, gone, on_main, shown, text
from tests.link.foreign_proposals_helpers import rogue
from tests.support.bridge import linked
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_extras.nodes.node_data import AskNodes, NodeChanges, Nodes, NodesNews, NodesSeen, NodeState, OneNode
from rsb_extras.nodes.tests.nodes_places import AGED, ANSWERED_WITHIN, LOOKED_FOR
from rsb_extras.nodes.tests.scripted_answers import KNOWN, NOW, PROCESS, answer_one

if TYPE_CHECKING:
    import pytest
    from tests.support.bridge import Bridge
    from textual.pilot import Pilot

    from rsb_bridge.engine import Engine
    from rsb_console.app import ConsoleApp


def names(engine: Engine) -> list[str]:
    return [each.name for each in engine.do(Nodes("robot1")).result(60).nodes]


def of(*names: str, number: int = 1) -> bytes:
    known = NodeChanges(1, number, True, 0, tuple(NodeState(each) for each in names))
    return zstandard.compress(msgspec.msgpack.encode(known))


def test_answer_after_its_time_counts(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    ANSWERED_WITHIN.set(monkeypatch, 0.1)
    server = bridge.server()
    with rogue(bridge, "nodes") as client:
        eventually(lambda: linked(server), what="a link")
        late = server.do(Nodes("robot1"))
        request = client.wait_for(AskNodes).request
        assert late.exception(60) is not None
        client.say(NodesNews(request, of("/there")), NodesNews(request, b"no frame: it is not read twice"))
        eventually(lambda: server.do(Nodes("robot1")).exception(60) is None, what="the late answer")
        assert names(server) == ["/there"]
        assert linked(server)


def test_look_after_a_pause_gets_the_nodes_of_now(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    LOOKED_FOR.set(monkeypatch, 0.0)
    server = bridge.server()
    with rogue(bridge, "nodes") as client:
        eventually(lambda: linked(server), what="a link")
        for number, name in enumerate(("/before", "/now"), 1):
            asked = server.do(Nodes("robot1"))
            client.say(NodesNews(client.wait_for(AskNodes).request, of(name, number=number)))
            assert [each.name for each in asked.result(60).nodes] == [name]


def test_silent_side_is_shown_with_the_age_of_its_nodes(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    ANSWERED_WITHIN.set(monkeypatch, 0.1)
    server = bridge.server()
    with rogue(bridge, "nodes") as client:
        eventually(lambda: linked(server), what="a link")
        asked = server.do(Nodes("robot1"))
        client.say(NodesNews(client.wait_for(AskNodes).request, of("/there")))
        assert asked.result(60).age == 0
        eventually(lambda: server.do(Nodes("robot1")).result(60).age >= 1, what="an age")
        assert names(server) == ["/there"]


@on_main(NARROW)
async def test_old_nodes_are_marked_and_a_page_says_when_it_was_read(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = NodesSeen(7, 20, True, NOW, KNOWN, (PROCESS,), age=4)
    AGED.set(monkeypatch, 70.0)
    played = {Nodes: lambda _: seen, OneNode: answer_one}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await pilot.press("O")
    await shown(pilot, "10 nodes, 1 ended, 1 not active")
    await gone(pilot, "as of")
    seen = NodesSeen(7, 20, True, NOW, KNOWN, (PROCESS,), age=77)
    await shown(pilot, "as of 77 s ago: no answer since")
    while app.screen.table.cursor_key != "/front/lidar_driver":  # type: ignore[attr-defined]  # the screen of nodes
        await pilot.press("j")
    await pilot.press("enter")
    await shown(pilot, "WARN 60 s ago: motor is hot")
    await shown(pilot, "ago: close this page and open it again")


@on_main(NARROW)
async def test_nodes_of_a_lost_side_are_shown_with_their_age(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = ""

    def answer(_: Nodes) -> NodesSeen:
        if problem:
            raise EngineError(problem)
        return NodesSeen(7, 20, True, NOW, KNOWN, (PROCESS,))

    AGED.set(monkeypatch, 1.0)
    monkeypatch.setattr("tests.console.scripted.answers", lambda: {Nodes: answer})
    await pilot.press("O")
    await shown(pilot, "10 nodes, 1 ended, 1 not active")
    problem = "robot1 is not linked: no route to host"
    await shown(pilot, problem)
    await shown(pilot, "s ago: no answer since")
    assert "✗ lidar_driver  ended 40 s ago" in text(app), "ages are those of that time"


@on_main(NARROW)
async def test_last_line_of_a_faulty_node_is_not_cut(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    stalled = replace(KNOWN[1], line=KNOWN[0].line)
    played = {Nodes: lambda _: NodesSeen(7, 20, True, NOW, (stalled, *KNOWN[2:]), (PROCESS,)), OneNode: answer_one}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await pilot.press("O")
    await shown(pilot, "camera_0  ERROR 41 s ago: motor stalled  42 %, 310 MB")


@on_main(NARROW)
async def test_a_problem_is_shown_with_its_remedy(
    app: ConsoleApp, pilot: Pilot[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = "the server does not show its nodes to demo: leave show_nodes out of client demo in the file of pc"
    played = {Nodes: lambda _: NodesSeen(0, 0, True, NOW, why_not=problem)}
    monkeypatch.setattr("tests.console.scripted.answers", lambda: played)
    await pilot.press("O")
    await shown(pilot, "does not show its nodes")
    assert problem in " ".join(text(app).replace("│", " ").split())
