"""Two features that should stop nothing: `test_door` runs this in a process of its own, where both are installed."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from rsb_door import METHODS, TAKEN  # type: ignore[import-not-found]
from tests.command.conftest import here, ran
from tests.console.driving import drive, scripted_app, shown, until
from tests.console.scripted import ROUTES
from tests.support.bridge import happened, is_accepted, linked
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import save
from rsb_bridge.config.validation import build, validate_topic
from rsb_bridge.feature import Feature
from rsb_bridge.installed_features import FeatureFault, feature_faults, installed
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.topic_keys import ADDED_KEYS
from rsb_console.actions.all_actions import ACTIONS, BY_ID
from rsb_console.command.arguments import parser_and_commands

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from textual.pilot import Pilot

__all__ = ["here", "ran"]  # fixtures
_OF_ENGINE = (
    "extensions", "observers", "parts", "transports", "transport_traits", "purposes", "messages", "refusal",
)  # fmt: skip
SCAN = Topic("/scan", "transmit", type="std_msgs/msg/String")


def reasons(method: str, feature: str = "greedy") -> list[str]:
    return [each.reason for each in feature_faults() if (each.feature, each.method) == (feature, method)]


def test_the_other_feature_raises_in_each_method() -> None:
    public = {name for name, _ in inspect.getmembers(Feature, inspect.isfunction) if not name.startswith("_")}
    assert public == METHODS


def test_bridges_work(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    for engine in (server, client):
        eventually(partial(happened, engine, EventCode.ENGINE_FEATURE_LEFT_OUT, "failing"), what="a line")
        eventually(partial(happened, engine, EventCode.ENGINE_FEATURE_LEFT_OUT, "greedy"), what="a line")
    for method in _OF_ENGINE:
        assert reasons(method, "failing"), method


def test_attached_console_works(bridge: Bridge, machine: Any) -> None:
    _, client = bridge.both(SCAN)
    machine.serve(client)
    remote = machine.attach()
    eventually(lambda: any(each.topic == "/scan" for each in remote.snapshot().routes), what="the topic")
    remote.add_topic(Topic("/more", "transmit", type="std_msgs/msg/String")).result(60)
    assert reasons("serve", "failing")


def test_headless_bridge_works(bridge: Bridge) -> None:
    path, server = bridge.folder / "client.yaml", bridge.server()
    save(bridge.client_session(SCAN), path)
    command = [sys.executable, "-m", "rsb_console", "run", "--no-ui", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as program:
        try:
            eventually(lambda: linked(server), what="linked")
        finally:
            program.terminate()
        output, _ = program.communicate(timeout=60)
    assert program.returncode == 0, output
    assert "the feature greedy: something of its transport_traits is left out: tcp is taken by the core" in output


def test_console_works_and_names_are_the_cores() -> None:
    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, ROUTES[0].topic)
        await pilot.press("question_mark")
        await until(pilot, lambda: type(pilot.app.screen).__name__ == "HelpScreen", "help")

    drive(scripted_app(routes=ROUTES), steps, size=(120, 36))
    assert BY_ID["help"].keys == "question_mark,f1"
    assert [each.keys for each in ACTIONS if each.id == "greedy"] == ["f9"]  # the key that is free is its own
    assert reasons("own_actions", "failing")


def test_session_files_are_read() -> None:
    fine = {"name": "robot1", "role": "server", "server_ip": "127.0.0.1", "server_port": 7060, "use_encryption": False}
    session, problems = build(fine)
    assert not problems
    assert session.name == "robot1"
    assert reasons("problems", "failing")


def test_entries_have_the_keys_that_are_free() -> None:
    of_this_tree = {key.name for each in installed() if each.name == "frames" for key in each.topic_keys()}
    assert set(ADDED_KEYS) - of_this_tree == {"fine_key"}
    assert any("the type of odd" in each for each in reasons("topic_keys"))
    assert not validate_topic(msgspec.structs.replace(SCAN, features={"fine_key": True}))
    assert reasons("topic_problems", "failing")


def test_doctor_names_each_taken_name_and_each_method() -> None:
    check = pytest.importorskip("rsb_extras.doctor.feature_check", reason="the core alone")
    machine = pytest.importorskip("rsb_extras.doctor.machine", reason="the core alone")
    machine.checks(os.environ)
    parser_and_commands()
    texts = [finding.text for finding in check.features()]
    for method, name in TAKEN:
        assert any("greedy" in text and method in text and name in text and "taken" in text for text in texts), name
    for method in ("subcommands", "commands", "session_keys", "actions", "screens", "columns", "message_views", "ways"):
        assert any("failing" in text and f"its {method} " in text for text in texts), method


@pytest.mark.parametrize("command", [("--help",), ("status",), ("check", "--help"), ("fine", "--help")])
def test_commands_work(command: tuple[str, ...]) -> None:
    """``fine`` is the greedy feature's own command whose name nobody else has."""
    done = subprocess.run(
        [sys.executable, "-m", "rsb_console", *command], capture_output=True, text=True, timeout=180, check=False
    )
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 3), done.stderr


def test_two_features_of_one_name_and_what_is_no_feature() -> None:
    assert [each.name for each in installed()].count("greedy") == 1
    whole = {each.feature for each in feature_faults() if not each.method}
    assert whole == {"greedy", "nonsense", "unloadable", "needy", "older"}
    assert [each.reason for each in feature_faults() if each.feature == "older"] == [
        "ImportError: it is written for version 0 of features, and this is 1; update or remove it"
    ]
    assert all(isinstance(each, FeatureFault) and each.reason for each in feature_faults())
