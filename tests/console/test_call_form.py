"""Services, actions and parameters added and edited by keyboard: found in both graphs, with their own fields."""

import functools
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    choose,
    engine_of,
    fill,
    form_of,
    gone,
    left_as_it_was,
    on_main,
    shown,
    told_to_add,
    until,
)
from tests.console.scripted import CALL_ROUTES, SESSION, ScriptedEngine, call_route
from textual.pilot import Pilot

from rsb_bridge.config.file_form import KEYS
from rsb_bridge.model.session import Client, Kind, Topic
from rsb_bridge.model.snapshot import TopicInfo
from rsb_console.app import ConsoleApp
from rsb_console.screens.topic_fields import KINDS, ORDER, fields_by_kind
from rsb_console.screens.topic_suggestions import suggestions_for
from rsb_console.session.draft import Ends, problems_of, topic_of, values_of

LOAD = TopicInfo("/map_server/load_map", "nav_msgs/srv/LoadMap", "", None, 1, 0, "service")
MODE = TopicInfo("/set_mode", "std_srvs/srv/SetBool", "", None, 0, 2, "service")
NAVIGATE = TopicInfo("/navigate_to_pose", "nav2_msgs/action/NavigateToPose", "", None, 1, 1, "action")
CONTROLLER = TopicInfo("/controller_server", "", "", None, 1, 0, "parameters")
ENDS = Ends(is_server=False, client="robot1", use_name=False)
SERVER = msgspec.structs.replace(
    SESSION, role="server", clients=(Client("robot1", use_name=True),), server_ip="0.0.0.0"
)


class Graphs(ScriptedEngine):
    """The other side has services, too."""

    def topics(self, link: str | None = None) -> Any:
        here = super().topics(link).result()
        return self._done((*here, LOAD, MODE, NAVIGATE, CONTROLLER) if link else here, "topics", link)


async def opened(pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "/map_server/load_map")


form = functools.partial(on_main, make_engine=Graphs, opening=opened)
"""A test's steps run with the form open, on a client."""


async def added(app: ConsoleApp, pilot: Pilot[None]) -> Topic:
    _, topic, _ = await told_to_add(pilot, app)
    assert isinstance(topic, Topic)
    return topic


@pytest.mark.parametrize(
    ("letters", "expected"),
    [
        ("load", Topic("/map_server/load_map", "transmit", "nav_msgs/srv/LoadMap", kind="service")),
        ("mode", Topic("/set_mode", "receive", "std_srvs/srv/SetBool", kind="service")),
        ("navi", Topic("/navigate_to_pose", "transmit", "nav2_msgs/action/NavigateToPose", kind="action")),
        ("contr", Topic("/controller_server", "transmit", kind="parameters")),
    ],
)
@form(NARROW)
async def test_entry_is_found_by_letters_with_type(
    app: ConsoleApp, pilot: Pilot[None], letters: str, expected: Topic
) -> None:
    await pilot.press(*letters)
    await shown(pilot, f"▌{'←' if expected.direction == 'receive' else '→'} {expected.topic}")
    await pilot.press("enter")
    await shown(pilot, f"◉ {expected.kind}")
    await until(pilot, lambda: form_of(app).fields["provider"].control.has_focus, "the next field")
    await pilot.press("enter")
    assert await added(app, pilot) == expected


@form()
async def test_chosen_kind_narrows_list_and_fields(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("f8")  # all fields
    await shown(pilot, "Stale after")
    await choose(pilot, "kind", "service")
    await gone(pilot, "/camera/depth")
    await shown(pilot, "2 clients there")
    await gone(pilot, "/navigate_to_pose")
    for absent in ("Direction", "QoS", "Stale after", "Expected rate", "○ udp"):
        await gone(pilot, absent)
    for present in ("Service  ", "Provider", "Timeout", "the server (there)", "Max rate"):
        await shown(pilot, present)
    await choose(pilot, "kind", "parameters")
    await gone(pilot, "/set_mode")
    await gone(pilot, "Type  ")
    await shown(pilot, "Node   ")
    await choose(pilot, "kind", "topic")
    await shown(pilot, "Direction")
    await shown(pilot, "/camera/depth")


@form()
async def test_name_that_is_typed_is_of_chosen_kind(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "kind", "service")
    await fill(pilot, topic="/reset", timeout="5", type="std_srvs/srv/Trigger")
    await choose(pilot, "provider", "client")
    await choose(pilot, "arm", "yes")
    await pilot.press("enter")
    expected = Topic("/reset", "receive", "std_srvs/srv/Trigger", timeout=5, arm=True, kind="service")
    assert await added(app, pilot) == expected


@form()
async def test_mistakes_are_said_at_their_fields(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "kind", "service")
    await fill(pilot, topic="/reset", timeout="soon", type="std_msgs/msg/String")
    await pilot.press("enter")
    await until(pilot, lambda: form_of(app).fields["timeout"].problem.display, "that it is no number")
    assert form_of(app).fields["type"].problem.display
    await shown(pilot, "/srv/")
    await fill(pilot, timeout="0.01")
    await shown(pilot, "out of range")
    assert not any(command[0] == "add" for command in engine_of(app).commands)


@form()
async def test_fields_of_topics_are_not_sent_with_service(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await choose(pilot, "protocol", "udp")
    await fill(pilot, qos="latched", stale_after="3")
    await choose(pilot, "kind", "service")
    assert form_of(app).values["protocol"] == "", "udp is no choice any more"
    await fill(pilot, topic="/reset")
    await pilot.press("enter", "enter")
    assert await added(app, pilot) == Topic("/reset", "transmit", kind="service")


EDITED = Topic("/set_mode", "receive", "std_srvs/srv/SetBool", timeout=5.0, kind="service")


@on_main(landmark="/set_mode", routes=(call_route("service", "/set_mode", spec=EDITED, outgoing=False),))
async def test_edit_begins_with_present_and_sends_new(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("e")
    await shown(pilot, "◉ the client (here)")
    await gone(pilot, "Kind  ")
    await gone(pilot, "QoS")
    await left_as_it_was(app, pilot, "/set_mode")
    await fill(pilot, timeout="8")
    await pilot.press("enter")
    await until(pilot, lambda: engine_of(app).commands, "the command")
    became = msgspec.structs.replace(EDITED, timeout=8)
    assert engine_of(app).commands == [("edit", "service /set_mode", became)]


@on_main(landmark="/robot1/set_mode", routes=CALL_ROUTES[:1])
async def test_service_is_paused_and_removed_like_topic(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("p")
    await until(pilot, lambda: ("pause", "service /robot1/set_mode", True) in engine_of(app).commands, "a pause")
    await pilot.press("d", "y")
    await until(pilot, lambda: ("remove", "service /robot1/set_mode") in engine_of(app).commands, "gone")


@on_main(session=SERVER, make_engine=Graphs)
async def test_on_server_provider_is_seen_from_there(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("a")
    await shown(pilot, "/map_server/load_map")
    await pilot.press(*"load", "enter")
    await shown(pilot, "○ the server (here)   ◉ the client (there)")


# -- what the form is made of ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_fields_of_its_session_entry(kind: Kind) -> None:
    fields = set(fields_by_kind(SESSION, ENDS, None)[kind])
    renamed = {"provider": "direction"}
    assert {renamed.get(key, key) for key in fields} - {"kind"} == set(KEYS[kind].values())
    assert fields <= set(ORDER)


@pytest.mark.parametrize("kind", KINDS)
def test_it_survives_the_form(kind: Kind) -> None:
    types = {"service": "std_srvs/srv/SetBool", "action": "nav2_msgs/action/NavigateToPose"}
    given = Topic("/name", "receive", types.get(kind, "auto"), arm=True, max_rate=2.5, kind=kind)
    if kind != "topic":
        given = msgspec.structs.replace(given, timeout=2.5)
    assert topic_of(values_of(given)) == given
    assert problems_of(given, SESSION, None) == {}


@pytest.mark.parametrize("is_server", [False, True])
def test_requests_go_to_where_somebody_answers(is_server: bool) -> None:
    ends = Ends(is_server, "robot1", use_name=False)
    offers = suggestions_for(ends, [LOAD], [MODE, replace(LOAD, topic="/there")], bridged=[])
    ways = {offer.value: offer.fills["provider"] for offer in offers}
    here, there = ("server", "client") if is_server else ("client", "server")
    assert ways == {"/map_server/load_map": here, "/set_mode": here, "/there": there}
    arrows = {offer.value: offer.line(80)[0][0].strip() for offer in offers}
    assert arrows == {"/map_server/load_map": "←", "/set_mode": "←", "/there": "→"}


@pytest.mark.parametrize("here", [True, False])
def test_services_of_a_bridged_node_are_not_offered(here: bool) -> None:
    called = [replace(LOAD, topic="/node/get_parameters"), replace(LOAD, topic="/node/load")]
    bridged = call_route("parameters", "/node")
    offers = suggestions_for(ENDS, called if here else [], [] if here else called, [bridged])
    assert [offer.value for offer in offers] == ["/node/load"]


def test_topics_come_first_kinds_may_share_name() -> None:
    topic = TopicInfo("/set_mode", "std_msgs/msg/Bool", "", None, 1, 0)
    offers = suggestions_for(ENDS, [topic], [CONTROLLER, NAVIGATE, MODE], [])
    assert [(offer.fills["kind"], offer.value) for offer in offers] == [
        ("topic", "/set_mode"),
        ("service", "/set_mode"),
        ("action", "/navigate_to_pose"),
        ("parameters", "/controller_server"),
    ]


def test_bridged_entries_are_not_offered_again() -> None:
    bridged = call_route(
        "service", "/a", remote_topic="/b", spec=Topic("/a", "transmit", remote_topic="/b", kind="service")
    )
    graph = [replace(MODE, topic="/b", publishers=1), replace(MODE, topic="/a"), replace(MODE, topic="/c")]
    assert [offer.value for offer in suggestions_for(ENDS, [], graph, [bridged])] == ["/a", "/c"]
    assert [offer.value for offer in suggestions_for(ENDS, graph, [], [bridged])] == ["/b", "/c"]
