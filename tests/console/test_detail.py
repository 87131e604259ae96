"""The detail pane: what it says of a topic in every state."""

from dataclasses import replace

import pytest
from tests.console.driving import NARROW, engine_of, gone, on_main, put, selected_topic, settled, shown, text, until
from tests.console.scripted import NOW, ROUTES, route
from textual.pilot import Pilot

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, State
from rsb_console.app import ConsoleApp
from rsb_console.notation import formats
from rsb_console.widgets.detail import DetailText, detail_lines


def said(about: RouteSnapshot, width: int = 60) -> str:
    return "\n".join("".join(piece for piece, _ in line) for line in detail_lines(about, "10.0.0.20:49152", width, NOW))


@on_main()
async def test_another_topic_is_shown_from_its_beginning(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.resize_terminal(120, 20)
    await pilot.press("enter", "end")
    await until(pilot, lambda: app.main.detail.scroll_offset.y > 0, "the pane's end")
    await settled(pilot)
    app.pull()
    assert app.main.detail.scroll_offset.y > 0, "the same topic stays where it was"
    await pilot.press("escape", "j")
    await until(pilot, lambda: app.main.detail.scroll_offset.y == 0, "the pane's beginning")


@on_main()
async def test_the_keys_of_a_list_scroll_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.resize_terminal(120, 20)
    await pilot.press("enter")
    pane = app.main.detail
    await until(pilot, lambda: pane.has_focus and pane.max_scroll_y > 3, "more than fits")
    await settled(pilot)
    for key, y in [
        ("j", 1), ("down", 2), ("k", 1), ("up", 0), ("G", pane.max_scroll_y), ("g", 0),
        ("end", pane.max_scroll_y), ("home", 0),
    ]:  # fmt: skip
        await pilot.press(key)
        await until(pilot, lambda y=y: pane.scroll_offset.y == y, f"{key}: line {y} at the top")
    await pilot.press("pagedown")
    await until(pilot, lambda: pane.scroll_offset.y > 1, "a page on")
    assert selected_topic(app) == "/robot2/scan", "the table's cursor stays"


def test_wanted_type_is_named_before_found() -> None:
    waiting = route("/scan", State.WAITING, type_name="", spec=Topic("/scan", "receive", type="LaserScan"))
    assert "LaserScan (as configured)" in said(waiting)
    assert DetailText.UNKNOWN_TYPE() in said(replace(waiting, spec=Topic("/scan", "receive")))


@on_main(landmark="← from 10.0.0.20:49152")
async def test_a_client_calls_its_peer_by_its_address(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("d")
    await shown(pilot, "10.0.0.20:49152.")
    await pilot.press("escape")
    engine_of(app).now = replace(engine_of(app).now, role="server")
    app.pull()
    await shown(pilot, "← from robot1")


def test_peer_and_carrier_are_whole_on_narrow_screens() -> None:
    bluetooth = route("/scan", transport="bluetooth", port=3)
    assert "10.0.0.20:49152  BLUETOOTH channel 3" in said(bluetooth)
    assert "BLUETOOTH channel 3" in said(bluetooth, 36)


WORDY = route(
    "/scan",
    qos=Qos(reliability="best_effort", durability="transient_local", depth=5, deadline=0.5),
    latency_p99=0.0123, last_error="No route to host, again and again", last_error_at=1e9,
)  # fmt: skip


@on_main(landmark="/scan", routes=(WORDY,))
async def test_long_text_continues_on_next_line(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("enter", "G")
    for words in (
        "best effort,  ", "transient local,  ", "deadline 500.0 ms", "± 400 µs", "No route to host,", "  and again",
    ):  # fmt: skip
        await shown(pilot, words)


@on_main(landmark="/scan", routes=(route("/scan", outgoing=True, transport="tcp", port=54757),))
async def test_the_scrollbar_hides_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """The line is too wide by one cell."""
    put(app, address="127.0.0.1:54757")
    await shown(pilot, "→ to 127.0.0.1:54757")
    await shown(pilot, "TCP port 54757")


@on_main(
    landmark="10.0/10   41.2   0.0",
    routes=(route("/scan", latency_p50=-0.0031, latency_p99=-0.0002, latency_uncertainty=0.004),),
)
async def test_no_latency_is_below_zero(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("enter", "end")
    await shown(pilot, "p50 <4.0 ms")
    await shown(pilot, "p99 <4.0 ms")
    await gone(pilot, "-3.1")
    assert formats.latency(-1.0, None) == "0 µs"


@pytest.mark.parametrize("about", ROUTES, ids=lambda about: about.state.value)
def test_only_stopped_routes_show_why_without_rate(about: RouteSnapshot) -> None:
    assert (DetailText.WHY_NOT_FLOWING() in said(about)) is (about.state is not State.OK)
    assert ("Rate  - Hz" in said(about)) is (about.state not in {State.OK, State.STALE})


def test_faulty_flow_names_fault_stopped_passes_no_stage() -> None:
    slow = said(route("/scan", State.SLOW, reason="robot1: 2 Hz of 20 expected", cause="slow"))
    assert "robot1: 2 Hz of 20 expected" in slow
    assert "all 10 passed\n" in slow
    stopped = said(route("/scan", State.STOPPED, reason="nothing for 3 s", cause="publisher_silent"))
    assert "nothing for 3 s" in stopped
    assert "Rate  0 Hz" in stopped
    assert "all 10 passed before" in stopped
    assert DetailText.NOTHING_COMES() in stopped


def test_the_curve_has_numbers_at_its_axis() -> None:
    lines = said(route("/scan", history=(0.0, 20.0) * 30)).splitlines()
    begin = next(number for number, line in enumerate(lines) if "Rate" in line)
    axis = [line.split("┤")[0].strip() for line in lines[begin:] if "┤" in line]
    assert axis == ["24.0", "0"]


def test_what_is_throttled_on_purpose_is_no_loss() -> None:
    ledger = Ledger(offered=100, delivered=20, throttled=80)
    words = said(route("/scan", max_rate=5.0, ledger=ledger))
    assert "limit 5 Hz" in words
    assert " Hz of 5 allowed" in said(route("/scan", expected_rate=5.0, max_rate=5.0))
    assert "100.0 %" in words


def test_what_is_unknown_is_neither_delivered_nor_dropped() -> None:
    ledger = Ledger(offered=100, delivered=40, unknown=60, missed_while_down=777)
    words = said(route("/scan", ledger=ledger))
    assert "100.0 %" in words
    assert [line.split()[-1] for line in words.splitlines() if line.strip().startswith("dropped")] == ["0"]
    assert "60" in words
    assert "777" in words


EVIL = "/ev\x1b[2Jil\x9b\n\x07\u202e"


@on_main(NARROW, landmark="/ev[2Jil", routes=(route(EVIL, State.DOWN, reason=f"because {EVIL}", type_name=EVIL),))
async def test_control_characters_never_go_out(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await settled(pilot)
    assert all(line.isprintable() for line in text(app).split("\n"))
    await pilot.press("d")
    await shown(pilot, "Remove /ev")
    app.notify(EVIL, markup=False)
    await settled(pilot)
    assert all(line.isprintable() for line in text(app).split("\n"))


def test_qos_of_both_ends_and_of_bridge() -> None:
    words = said(route("/scan", publisher_qos=Qos("best_effort", deadline=0.5), subscriber_qos=Qos()))
    assert "QoS         best effort, volatile, last 5\n" in words
    assert "publishers  offer best effort, volatile, deadline 500.0 ms\n" in words
    assert "subscribers ask for reliable, volatile\n" in words
    named = said(route("/scan", publishers=("/lidar", "/spare"), subscriber_qos=Qos(), subscribers=("/rviz",)), 90)
    assert "publishers  /lidar, /spare, offer best effort, volatile\n" in named
    assert "subscribers /rviz, ask for reliable, volatile\n" in named
    nobody = said(route("/scan", publisher_qos=None, subscriber_qos=None))
    assert "publishers" not in nobody
    assert "subscribers" not in nobody


def test_no_port_where_there_is_none() -> None:
    """A Zenoh network has no ports."""
    over_zenoh = replace(route("/scan"), transport="zenoh", port=0)
    assert "port" not in said(over_zenoh)
    assert "port 49153" in said(replace(over_zenoh, transport="tcp", port=49153))
