"""A server's console on a real engine: its robots are processes of their own."""

import os
from pathlib import Path

import pytest
from msgspec.structs import replace
from tests.console.driving import fill, shown, until
from tests.console.live import ELSEWHERE, HERE, Pair, bridging, console, flows, talker, watch
from textual.pilot import Pilot

from rsb_bridge.config.session_file import load, parse, save
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import LinkSnapshot, State
from rsb_console.app import ConsoleApp
from rsb_console.screens.links_screen import CLIENT_KEYS
from rsb_console.session.client_files import handed_out, open_server, robot_file

pytest.importorskip("rclpy", reason="needs ROS 2")
CHATTER = f"/clients_{os.getpid()}/chatter"


def link_of(app: ConsoleApp, name: str) -> LinkSnapshot | None:
    """A client's link, if it is up."""
    return next((link for link in app.snapshot().links if link.name == name and link.state is State.OK), None)


def test_fleet_grows_and_shrinks_under_its_operators_hands(tmp_path: Path) -> None:
    pair = Pair(tmp_path)
    app = console(pair.server_path)
    robot2 = tmp_path / "robot2.yaml"

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "● LINKED")
        first = link_of(app, "robot1")
        assert first is not None
        await pilot.press("a", *"chatter")
        await shown(pilot, f"▌← {CHATTER[:20]}")
        await pilot.press("enter")
        await shown(pilot, "std_msgs/msg/String")
        await pilot.press("enter")
        await until(pilot, lambda: flows(app.snapshot(), CHATTER), "20 Hz")

        await pilot.press("c")
        await shown(pilot, CLIENT_KEYS)
        await pilot.press("a")
        await shown(pilot, "Add a client")
        await fill(pilot, name="robot2")
        await pilot.press("enter")
        await shown(pilot, "robot2 is added")
        write_robot(pair.server_path, robot2)
        with bridging(robot2):
            await until(pilot, lambda: link_of(app, "robot2"), "robot2")
            await pilot.press("escape")
            await shown(pilot, CLIENT_KEYS)
            links = app.screen.query_one("#links")
            await until(pilot, lambda: getattr(links, "keys", ()) == ["robot1", "robot2"], "both, none of them worse")
            await pilot.press("j")
            await until(pilot, lambda: getattr(links, "cursor_key", "") == "robot2", "robot2 chosen")
            await pilot.press("d")
            await shown(pilot, "Remove the client robot2?")
            await pilot.press("y")
            await until(pilot, lambda: [link.name for link in app.snapshot().links] == ["robot1"], "robot1 alone")
        now = link_of(app, "robot1")
        assert now is not None
        assert app.engine is not None
        of_link = [event.text for event in app.engine.events() if event.link == "robot1"]
        assert now.since == first.since, f"its link stayed all along: {of_link}"
        await pilot.press("escape", "w")
        await shown(pilot, f"added {CHATTER} for robot1")
        await pilot.press("y")
        await shown(pilot, "saved:")

    with bridging(pair.client_path), talker(CHATTER, domain=HERE):
        watch(app, steps)
    kept = Topic(CHATTER, "transmit", "std_msgs/msg/String")
    assert load(pair.server_path).clients == (Client("robot1", topics=(kept,)),)


def write_robot(server: Path, path: Path) -> None:
    """Write the second client's session, in a domain where nobody talks."""
    (changed,) = [each for each in handed_out(open_server(server)) if each.client.name == "robot2"]
    text = robot_file(changed.file.session, changed.client)
    save(replace(parse(text, path), domain_id=ELSEWHERE), path)
