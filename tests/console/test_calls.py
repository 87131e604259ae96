"""Services, actions and parameters next to topics: in the table, in the header and in the detail."""

from dataclasses import replace
from typing import get_args

import pytest
from tests.console.detail_helpers import said
from tests.console.driving import NARROW, gone, listed, on_main, put, shown, text, until
from tests.console.scripted import CALL_ROUTES, CALLS, ROUTES, call_route, call_stages, route
from textual.pilot import Pilot

from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
from rsb_bridge.model.session import Topic
from rsb_bridge.model.transports import Protocol
from rsb_console.app import ConsoleApp
from rsb_console.notation import formats
from rsb_console.preferences import TOPIC_COLUMNS
from rsb_console.widgets.detail import DetailText
from rsb_console.widgets.topics import FAULTS, layout, via

ALL = (*ROUTES, *CALL_ROUTES)


# -- the table -------------------------------------------------------------------------------------------------------


@on_main()
async def test_kind_has_column_where_not_all_are_topics(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "KIND")
    put(app, *ALL)
    await shown(pilot, "KIND TOPIC")
    for row in ("msg  /tf", "srv  /robot1/set_mode", "act  /navigate_to_pose", "par  /controller_server"):
        await shown(pilot, row)


@on_main()
async def test_a_filter_finds_a_kind(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await pilot.press("slash", *"kind:service")
    await until(pilot, lambda: len(listed(app)) == 2, "both services")
    assert all(each.spec.kind == "service" for each in app.main.topics.listed)
    await pilot.press("enter", "escape", "slash", *"kind:par")
    await until(pilot, lambda: listed(app) == ["/controller_server"], "the parameters")
    await pilot.press("enter", "escape", "slash", *"!kind:msg state:down")
    await until(pilot, lambda: len(listed(app)) == 1, "what is down and no topic")


@on_main()
async def test_sorting_by_kind_keeps_the_kinds_together(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await pilot.press("greater_than_sign")
    await shown(pilot, "KIND▼"[:4])
    await until(
        pilot,
        lambda: (
            [each.spec.kind for each in app.main.topics.listed][-4:] == ["service", "service", "action", "parameters"]
        ),
        "the kinds in their order",
    )


@on_main()
async def test_calls_per_second_open_ones_and_latency(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await shown(pilot, "→ TCP      0.4 +1   0.8  1.4s")
    put(app, call_route("service", "/quiet", calls=replace(CALLS, in_flight=0)))
    await shown(pilot, "→ TCP         0.4   0.8  1.4s")


@pytest.mark.parametrize("width", [60, 81, 100, 120, 160, 200])
@pytest.mark.parametrize("calls", [False, True])
@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize("wanted", [None, frozenset(TOPIC_COLUMNS)], ids=["usual", "all"])
def test_the_columns_fit_and_leave_room_for_names(
    width: int, calls: bool, grouped: bool, wanted: frozenset[str] | None
) -> None:
    columns = layout(width, peers=grouped, grouped=grouped, calls=calls, wanted=wanted)
    assert sum(cells + 1 for _, cells in columns) < width + 1
    name = next(cells for column, cells in columns if column.title == "TOPIC")
    assert name >= (10 if grouped else 14)
    titles = [column.title for column, _ in columns]
    assert ("KIND" in titles) is calls
    if wanted is None:
        assert ("NODE" in titles) is (calls and width >= 100)


@pytest.mark.parametrize("transport", get_args(Protocol))
def test_the_column_of_transports_has_room_for_each(transport: str) -> None:
    assert len(via(route("/scan", transport=transport, port=30))) <= 7


@on_main((200, 40))
async def test_wide_table_has_last_failure_and_nodes_time(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await pilot.press("z")
    await shown(pilot, "LAST FAILURE")
    row = next(line for line in text(app).splitlines() if "/robot1/set_mode" in line)
    assert "0.8  12.0  1.4s" in row
    assert "the call of 02:31:07: no answer" in row


@on_main()
async def test_what_failed_is_found_by_its_cause(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL, call_route("service", "/fine", calls=CallsSnapshot(asked=1, answered=1)))
    await pilot.press("slash", *"why:no.answer.within")
    await until(pilot, lambda: len(listed(app)) == 3, "those whose last failure it was")


@on_main(NARROW)
async def test_long_name_keeps_its_beginning_and_its_end(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *(call_route("service", f"/controller_server/{what}_state") for what in ("change", "get")))
    await shown(pilot, "e_state")
    rows = [line for line in text(app).splitlines() if "srv  /con" in line]
    assert len(set(rows)) == 2, "lifecycle services begin alike"


# -- the header ------------------------------------------------------------------------------------------------------


def test_counts_in_words() -> None:
    assert formats.counted_kinds([]) == "0 topics"
    assert formats.counted_kinds(["topic"]) == "1 topic"
    assert formats.counted_kinds(["service", "service"]) == "2 services"
    assert formats.counted_kinds(["parameters", "topic", "action"]) == "1 topic, 1 action, parameters of 1 node"
    assert formats.counted_kinds(["parameters"] * 3) == "parameters of 3 nodes"


@on_main()
async def test_both_are_counted_in_the_header(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "under way")
    put(app, *ALL)
    await shown(pilot, "8 topics, 2 services, 1 action, parameters of 1 node")
    await shown(pilot, "2 calls under way, 12 failed")
    await pilot.resize_terminal(160, 36)
    await shown(pilot, "✗ 2 down")
    await shown(pilot, "2 calls under way, 12 failed")
    put(app, call_route("service", "/fine", calls=CallsSnapshot(asked=1, in_flight=1)))
    await shown(pilot, " 1 service  ● 1 ok │ drops 0 │ 1 call under way, 0 failed")


@on_main(NARROW)
async def test_the_counts_fit_on_a_narrow_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await shown(pilot, "8 topics, 2 services, 1 action, parameters of 1 node ✗2 ▲1 ‖1 ●8")


@on_main()
async def test_service_that_is_down_is_fault_like_topic(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, *ALL)
    await shown(pilot, "✗ /robot1/map_server/load_map: no server of /map_server/load_map")
    await pilot.press("f")
    await until(pilot, lambda: all(each.state in FAULTS for each in app.main.topics.listed), "faults only")
    assert "/robot1/map_server/load_map" in listed(app)


# -- the detail ------------------------------------------------------------------------------------------------------


def test_a_service_that_does_not_answer_says_why() -> None:
    words = said(CALL_ROUTES[1])
    assert DetailText.WHY_NO_ANSWER() in words
    assert "✗ server seen" in words
    assert "no server of /map_server/load_map in domain 4" in words
    assert "offered, called" in words


def test_nothing_is_said_of_messages() -> None:
    for about in CALL_ROUTES:
        words = said(about)
        assert "message" not in words
        assert "flowing" not in words
        assert "delivered" not in words
        assert "last call" in words or about.last_at is None


@pytest.mark.parametrize("outgoing", [True, False])
def test_ledger_of_calls_balances_with_late_answers(outgoing: bool) -> None:
    words = said(call_route("service", "/set_mode", outgoing=outgoing))
    lines = {line[:18].strip(): line[18:].split() for line in words.splitlines()}
    parts = ("answered", "expired", "refused", "lost", "in flight")
    assert sum(int(lines[part][0]) for part in parts) == int(lines["asked"][0]) == CALLS.asked
    assert lines["calls under way"] == ["2"]
    assert lines["answered"] == ["115", "96.6", "%"]
    assert "apart from these: 1 late answer\n" in words
    assert ("→ answered by 10.0.0.20" in words) is outgoing
    assert ("← called by 10.0.0.20" in words) is not outgoing
    assert f"{'far node ' if outgoing else 'node here'}   p50 12.0 ms  p99 40.0 ms" in words
    assert "the way     p50 800 µs  p99 2.1 ms, there and back" in words
    assert f"given up    {DetailText.GIVEN_UP(timeout=30)}" in words
    assert "the call of 02:31:07: no answer within 30 s" in words
    assert "wait for the node" not in words
    waiting = said(call_route("service", "/set_mode", calls=replace(CALLS, waiting=7)))
    assert ["wait", "for", "the", "node", "7"] in [line.split() for line in waiting.splitlines()]


def test_without_calls_there_are_no_figures() -> None:
    words = said(call_route("service", "/set_mode", calls=CallsSnapshot(), stages=call_stages(5)))
    for absent in ("%", "late", "Last failure", "far node", "the way"):
        assert absent not in words


def test_goals_show_state_age_and_waiting_callers() -> None:
    words = said(CALL_ROUTES[2])
    assert "Goals  2 under way" in words
    assert "▸ executing since 07:59:18\n   3f2a91c0  130 feedbacks, its caller waits" in words
    assert "▸ canceling since 07:59:57\n   91c03f2a  12 feedbacks\n" in words
    assert "✗ aborted since" in words
    lost = said(call_route("action", "/navigate", goals=(GoalSnapshot(f"{1:032x}", "unknown", 0.0),)))
    assert "Goals  0 under way" in lost
    assert "· unknown since" in lost
    many = tuple(GoalSnapshot(f"{number:032x}", "accepted", 0.0, 1) for number in range(20))
    words = said(call_route("action", "/navigate", goals=many))
    assert "and 12 more" in words
    assert "1 feedback\n" in words


def test_callers_and_providers_are_named() -> None:
    words = said(call_route("service", "/set_mode", publishers=("/bt_navigator", "/rqt"), subscribers=("/driver",)))
    assert "callers     /bt_navigator, /rqt\n" in words
    assert "providers   /driver\n" in words


def test_parameters_have_no_type_of_their_own() -> None:
    assert DetailText.ALL_PARAMETERS() in said(CALL_ROUTES[3])
    unknown = call_route("service", "/set_mode", type_name="")
    assert DetailText.UNKNOWN_TYPE() in said(unknown)
    asked_for = Topic("/set_mode", "transmit", "std_srvs/srv/SetBool", kind="service")
    assert "std_srvs/srv/SetBool (as configured)" in said(replace(unknown, spec=asked_for))


@on_main(NARROW, landmark="/navigate_to_pose", routes=CALL_ROUTES[2:3])
async def test_what_stands_in_a_narrow_detail_is_whole(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("enter", "G")
    await shown(pilot, "given up    after 30 s")
    await gone(pilot, "Stages")
