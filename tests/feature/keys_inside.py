"""A feature's keys of entries, where it is installed: `test_entry_keys` runs this in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from rsb_keys import FRAGILE, HIGH, LOW  # type: ignore[import-not-found]
from tests.command.conftest import here, ran
from tests.console.driving import drive, scripted_app, shown
from tests.console.scripted import ROUTES
from tests.support.bridge import happened, is_accepted, linked, reloaded, route
from tests.support.inside import inside
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import SessionError, load, save
from rsb_bridge.config.validation import build
from rsb_bridge.link.proposals import amendment
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.topic_keys import ForeignKey

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from textual.pilot import Pilot

    from rsb_bridge.engine.engine import Engine

__all__ = ["here", "ran"]  # fixtures
SCAN = Topic("/scan", "transmit", type="std_msgs/msg/String", features={"band_low": 8.0, "fragile": True})
COMMON = {"name": "robot1", "role": "client", "server_ip": "10.0.0.1", "server_port": 7060, "use_encryption": False}


def low(engine: Engine) -> Any:
    return LOW.of(route(engine, "/scan").spec)


def test_file_says_them_and_keeps_them(tmp_path: Path) -> None:
    entry = {"topic": "/scan", "direction": "transmit", "band_low": 8, "fragile": True, "band_high": 500}
    session, problems = build(COMMON | {"topics": [entry]})
    assert not problems
    (topic,) = session.topics
    assert topic.features == {"band_low": 8.0, "fragile": True, "band_high": 500.0}
    save(session, tmp_path / "robot1.yaml")
    assert load(tmp_path / "robot1.yaml") == session
    assert "band_low: 8" in (tmp_path / "robot1.yaml").read_text()
    default = entry | {"fragile": False, "band_high": 1000}
    assert build(COMMON | {"topics": [default]})[0].topics[0].features == {"band_low": 8.0}


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("band_low: fast", "is not a number"),
        ("band_low: -1", "out of range: 0 to 1000, or leave it out"),
        ("band_high: 2, band_low: 8", "band_low is above band_high"),
        ("band_lo: 8", "did you mean band_low"),
        (f"place: {'a' * 256}", "at most 255 printable characters"),
        ('place: "a\\tb"', "at most 255 printable characters"),
    ],
)
def test_mistakes_have_their_line(tmp_path: Path, entry: str, text: str) -> None:
    path = tmp_path / "robot1.yaml"
    common = "".join(f"{key}: {str(value).lower()}\n" for key, value in COMMON.items())
    path.write_text(f"{common}topics:\n  - {{topic: /scan, direction: transmit, {entry}}}\n")
    with pytest.raises(SessionError) as caught:
        load(path)
    (problem,) = caught.value.problems
    assert text in problem.message
    assert problem.line == len(COMMON) + 2


def test_service_has_only_its_own() -> None:
    service = {"service": "/dock", "provider": "server"}
    session, problems = build(COMMON | {"services": [service | {"fragile": True}]})
    assert not problems
    assert FRAGILE.of(session.topics[0])
    _, (problem,) = build(COMMON | {"services": [service | {"band_low": 8}]})
    assert says(problem.message, ForeignKey.OF_TOPICS_ONLY)
    program = [sys.executable, "-m", "rsb_console", "edit", "--help"]
    text = subprocess.run(program, capture_output=True, text=True, timeout=180, check=True).stdout
    of_topics, _, of_calls = " ".join(text.split()).partition("for a service")
    assert "band_low=" in of_topics
    assert "band_low=" not in of_calls
    assert "fragile=" in of_calls


def test_other_side_gets_what_is_for_it(bridge: Bridge, tmp_path: Path) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan") and is_accepted(server, "/scan"), what="open")
    assert (low(client), low(server)) == (8.0, 8.0)
    assert FRAGILE.of(route(client, "/scan").spec)
    assert not FRAGILE.of(route(server, "/scan").spec)
    before = route(client, "/scan").key
    path = tmp_path / "robot1.yaml"
    save(client.session, path)
    changed = msgspec.structs.replace(SCAN, features={"band_low": 9.0})
    (text,) = reloaded(client, path, topics=(changed,)).changed
    assert text == "/scan (transmit): band_low 8.0 → 9.0, fragile true → false"
    eventually(lambda: low(server) == 9.0, what="told the other side")
    assert happened(client, EventCode.ROUTE_AMENDED, "band_low 8 → 9, fragile yes → no")
    assert route(client, "/scan").key == before


def test_side_that_does_not_list_it_edits_what_is_for_both(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan") and is_accepted(server, "/scan"), what="open")
    shown_there = route(server, "/scan")
    wanted = msgspec.structs.replace(shown_there.spec, features={"band_low": 9.0})
    server.edit_topic(shown_there.key, wanted).result(60)
    eventually(lambda: low(client) == 9.0, what="edited")
    assert FRAGILE.of(route(client, "/scan").spec)
    wanted = msgspec.structs.replace(wanted, features={"band_low": 9.0, "fragile": True})
    for each in (wanted, msgspec.structs.replace(wanted, arm=True)):
        with pytest.raises(EngineError, match="fragile"):
            server.edit_topic(shown_there.key, each).result(60)


def test_commands_edit_and_show_them(bridge: Bridge, machine: Any, ran: Any) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: linked(server) and is_accepted(client, "/scan"), what="open")
    machine.serve(client)
    assert ran("edit", "/scan", "band_low=7", "fragile=no").code == 0
    eventually(lambda: low(client) == 7.0, what="edited")
    assert "band_low 7" in ran("info", "/scan").out
    assert ran("info", "/scan", "--json").json["features"] == {"band_low": 7.0}
    assert ran("edit", "/scan", "band_low=fast").code == 2
    assert ran("edit", "/scan", "band_low=5000").code == 2


def test_form_has_a_field_for_each() -> None:
    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, ROUTES[0].topic)
        await pilot.press("e")
        await shown(pilot, "Lowest rate")
        await shown(pilot, "Fragile")
        await shown(pilot, str(HIGH.default))

    drive(scripted_app(routes=ROUTES), steps, size=(120, 60))


def amend(client: Engine, value: Any) -> None:
    """Have a client send a change that its own version of the feature could not make."""
    (link,) = inside(client).role.links()
    (one,) = link.routes.values()
    proposal = msgspec.structs.replace(one.proposal, features={"band_low": value})

    def send() -> None:
        link.send(amendment(proposal, one.id))

    inside(client).context.call(send)


def both_open(server: Engine, client: Engine) -> None:
    eventually(lambda: is_accepted(client, "/scan") and is_accepted(server, "/scan"), what="open")


@pytest.mark.parametrize("listed_on_both", [False, True])
def test_change_with_mistake_is_refused_like_proposal(bridge: Bridge, listed_on_both: bool) -> None:
    """The other side may have another version of the feature, whose key has another type or range."""
    server, client = bridge.both(SCAN)
    both_open(server, client)
    if listed_on_both:
        server.add_topic(SCAN).result(60)
    for value, mistake in (("fast", "band_low: Expected `float`, got `str`"), (5000.0, "out of range")):
        amend(client, value)
        eventually(lambda mistake=mistake: happened(client, EventCode.ROUTE_REFUSED, mistake), what="refused")
        both_open(server, client)
    assert happened(server, EventCode.LINK_LOST) is None
    assert bool(listed_there(server)) is listed_on_both


def test_each_session_that_lists_it_has_its_own(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    both_open(server, client)
    server.add_topic(msgspec.structs.replace(SCAN, features={"band_low": 5.0})).result(60)
    for change in ({"max_rate": 3.0}, {"express": True}):  # of an open route, and of one that opens anew
        shown_here = route(client, "/scan")
        client.edit_topic(shown_here.key, msgspec.structs.replace(shown_here.spec, **change)).result(60)
        ((name, value),) = change.items()
        eventually(lambda name=name, value=value: getattr(route(server, "/scan").spec, name) == value, what="told")
        assert (low(client), low(server)) == (8.0, 5.0)
    shown_there = route(server, "/scan")
    wanted = msgspec.structs.replace(shown_there.spec, features={"band_low": 6.0}, max_rate=2.0)
    server.edit_topic(shown_there.key, wanted).result(60)
    eventually(lambda: route(client, "/scan").spec.max_rate == 2.0, what="edited there")
    eventually(lambda: route(server, "/scan").spec.max_rate == 2.0, what="and here")
    assert (low(client), low(server)) == (8.0, 6.0)
    assert [each.features for each in listed_there(server)] == [{"band_low": 6.0}]


def listed_there(server: Engine) -> tuple[Topic, ...]:
    """Return what the server's session lists."""
    (link,) = inside(server).role.links()
    listed: tuple[Topic, ...] = link.proposed.all()
    return listed
