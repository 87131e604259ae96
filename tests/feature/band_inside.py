"""The feature of tests/feature/band, where it is installed: `test_band` runs this in a process of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
from rsb_band import LOW  # type: ignore[import-not-found]
from tests.command.conftest import here, ran
from tests.console.driving import drive, engine_of, fill, scripted_app, shown, until
from tests.console.scripted import ROUTES
from tests.support.bridge import happened, is_accepted, linked, route
from tests.support.waiting import eventually

from rsb_bridge.config.validation import build
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    import pytest
    from tests.support.bridge import Bridge
    from textual.pilot import Pilot

__all__ = ["here", "ran"]  # fixtures
SCAN = Topic("/scan", "transmit", type="std_msgs/msg/String", features={"band_low": 8.0, "band_high": 12.0})
FREE = msgspec.structs.replace(SCAN, features={})


def test_rate_outside_is_a_fault_on_both_sides_and_ends(bridge: Bridge) -> None:
    """The publisher sends nothing, so that the rate is below."""
    bridge.robot.publisher("/scan")
    server, client = bridge.both(SCAN, features={"band_after": 0.0})
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    for engine in (server, client):
        eventually(lambda engine=engine: route(engine, "/scan").cause == "band.left", what="a fault")
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_FAULT, "0 Hz, below 8"), what="in the log")
        assert happened(engine, "band.left", "0 Hz, below 8")  # type: ignore[arg-type]
    client.edit_topic(route(client, "/scan").key, FREE).result(60)
    for engine in (server, client):
        eventually(lambda engine=engine: happened(engine, "band.back"), what="over")  # type: ignore[arg-type]
        eventually(lambda engine=engine: route(engine, "/scan").cause != "band.left", what="no fault")


def test_console_rings_when_a_topic_leaves_its_band(
    bridge: Bridge, machine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge.robot.publisher("/scan")
    server, client = bridge.both(FREE, features={"band_after": 0.0})
    eventually(lambda: linked(server) and is_accepted(client, "/scan"), what="open")
    machine.serve(client)
    app = scripted_app(session=None, path=None, attach_to=machine.folder / "robot1.sock")
    rings: list[bool] = []
    monkeypatch.setattr(app, "bell", lambda: rings.append(True))

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/scan")
        client.edit_topic(route(client, "/scan").key, SCAN).result(60)
        await until(pilot, lambda: rings, "the bell")

    drive(app, steps)


def test_key_of_the_console_sets_a_band() -> None:
    app = scripted_app(routes=ROUTES)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, ROUTES[0].topic)
        await shown(pilot, "BAND")
        await pilot.press("Z")
        await until(pilot, lambda: type(pilot.app.screen).__name__ == "BandScreen", "the form")
        await fill(pilot, band_low="8", band_high="12")
        await pilot.press("enter")
        await until(pilot, lambda: engine_of(app).commands, "a command")
        name, _, topic, *_ = engine_of(app).commands[0]
        assert name == "edit"
        assert topic.features == {"band_low": 8.0, "band_high": 12.0}  # type: ignore[attr-defined]

    drive(app, steps, size=(240, 36))


def test_commands_show_it(bridge: Bridge, machine: Any, ran: Any) -> None:
    bridge.robot.publisher("/scan")
    _, client = bridge.both(SCAN, features={"band_after": 0.0})
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    machine.serve(client)
    eventually(lambda: route(client, "/scan").cause == "band.left", what="a fault")
    status = ran("status", "--json")
    assert status.code == 1
    assert [each["cause"] for each in status.json["routes"] if each["topic"] == "/scan"] == ["band.left"]
    watched = ran("watch", "/scan", "--low", "8", "--once")
    assert watched.code == 1
    assert "/scan: 0 Hz, below 8" in watched.out
    assert ran("watch", "/none", "--low", "8", "--once").code == 2


def test_mistakes_name_their_key() -> None:
    entry = {"topic": "/scan", "direction": "transmit", "band_low": 12, "band_high": 8}
    session = {
        "name": "robot1",
        "role": "client",
        "server_ip": "10.0.0.1",
        "server_port": 7060,
        "use_encryption": False,
    }
    found = build(session | {"topics": [entry], "band_after": -1})[1]
    assert {each.location for each in found} == {"topics[0].band_low", "band_after"}
    assert LOW.of(build(session | {"topics": [entry | {"band_low": 1}]})[0].topics[0]) == 1.0
