"""Whether the running session differs from its file, and saving it there from any console."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support.bridge import happened, route
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern

from rsb_bridge.api import EngineError, Unable
from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_changes import with_client
from rsb_bridge.config.session_file import SavingProblem, dump, load, load_file, save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import Save, acting
from rsb_bridge.model.session import Client, Topic

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine

SCAN, MAP = Topic("/scan", "transmit"), Topic("/map", "transmit")


def on_file(engine: Engine, path: Path) -> Path:
    """Give an engine a file with a comment."""
    path.write_text(f"# mine\n{dump(engine.session)}")
    engine.use_file(path)
    return path


def test_a_change_is_unsaved_until_it_is_saved(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    for side, topic in (client, MAP), (server, Topic("/goal", "receive")):
        path = on_file(side, bridge.folder / f"{side.session.role}.yaml")
        eventually(lambda side=side: not side.snapshot().unsaved)
        side.add_topic(topic).result(60)
        assert side.snapshot().unsaved
        with acting("anna"):
            side.do(Save()).result(60)
        assert not side.snapshot().unsaved
        assert path.read_text().startswith("# mine\n")
        assert load(path).topics or load(path).listed_clients[0].topics
        assert [event.who for event in side.events() if event.code == EventCode.OPERATOR_SAVED] == ["anna"]


def test_change_of_other_side_s_session_is_unsaved_there(bridge: Bridge) -> None:
    """The robot lists the topic: until it is saved there, the robot's restart loses what the server's operator did."""
    server, client = bridge.both(SCAN)
    on_file(client, bridge.folder / "robot.yaml")
    on_file(server, bridge.folder / "server.yaml")

    def unsaved_there() -> list[bool]:
        return [side.snapshot().links[0].unsaved_there for side in (server, client)]

    key = route(server, "/scan").key
    changes = (
        lambda: server.edit_topic(key, msgspec.structs.replace(SCAN, max_rate=5.0)),
        lambda: server.pause(key, True),
        lambda: server.remove_topic(key),
    )
    for change in changes:
        change().result(60)
        eventually(lambda: unsaved_there() == [True, False])
        assert not server.snapshot().unsaved
        assert client.snapshot().unsaved
        client.do(Save()).result(60)
        eventually(lambda: unsaved_there() == [False, False])


def test_own_changes_are_not_told_to_other_side(bridge: Bridge) -> None:
    server, client = bridge.both(SCAN)
    on_file(client, bridge.folder / "robot.yaml")
    client.pause(route(client, "/scan").key, True).result(60)
    holds(lambda: not server.snapshot().links[0].unsaved_there, 2.5)


def test_a_change_that_is_taken_back_is_saved(bridge: Bridge) -> None:
    _, client = bridge.both(SCAN)
    on_file(client, bridge.folder / "robot.yaml")
    client.pause(route(client, "/scan").key, True).result(60)
    assert client.snapshot().unsaved
    client.pause(route(client, "/scan").key, False).result(60)
    assert not client.snapshot().unsaved


def test_a_reload_leaves_nothing_unsaved(bridge: Bridge) -> None:
    _, client = bridge.both(SCAN)
    on_file(client, bridge.folder / "robot.yaml")
    client.add_topic(MAP).result(60)
    client.reload().result(60)
    assert not client.snapshot().unsaved


def test_a_file_changed_by_others_is_not_overwritten(bridge: Bridge) -> None:
    _, client = bridge.both(SCAN)
    path = on_file(client, bridge.folder / "robot.yaml")
    client.add_topic(MAP).result(60)
    for text in f"# theirs\n{path.read_text()}", "name: [\n":
        path.write_text(text)
        with pytest.raises(EngineError, match=pattern(SavingProblem.CHANGED)):
            client.do(Save()).result(60)
        assert path.read_text() == text
        assert client.snapshot().unsaved


def test_another_console_may_have_saved_the_same(bridge: Bridge) -> None:
    _, client = bridge.both(SCAN)
    path = on_file(client, bridge.folder / "robot.yaml")
    client.add_topic(MAP).result(60)
    save(client.session, path, load_file(path))
    text = path.read_text()
    client.do(Save()).result(60)
    assert not client.snapshot().unsaved
    assert path.read_text() == text


def test_clients_that_are_in_the_file_are_saved(bridge: Bridge) -> None:
    server = bridge.server(clients=(Client("robot1"),))
    path = on_file(server, bridge.folder / "server.yaml")
    write_key(bridge.folder / "two.key")
    server.add_topic(MAP, "robot1").result(60)
    opened, client = load_file(path), Client("robot2", "two.key")
    save(with_client(opened.session, client), path, opened)
    server.add_client(client).result(60)
    assert server.snapshot().unsaved, "the topic is not saved"
    server.do(Save()).result(60)
    assert [len(each.topics) for each in load(path).listed_clients] == [1, 0]
    save(msgspec.structs.replace(load(path), clients=load(path).listed_clients[:1]), path, load_file(path))
    server.remove_client("robot2").result(60)
    assert not server.snapshot().unsaved


def test_a_session_without_a_file_is_not_unsaved(bridge: Bridge) -> None:
    _, client = bridge.both(SCAN)
    client.add_topic(MAP).result(60)
    assert not client.snapshot().unsaved
    with pytest.raises(EngineError, match=pattern(Unable.NO_FILE)):
        client.do(Save()).result(60)
    assert not happened(client, EventCode.OPERATOR_SAVED)


def test_key_files_elsewhere_are_left_to_the_console(bridge: Bridge, tmp_path: Path) -> None:
    _, client = bridge.both(SCAN)
    (tmp_path / "other").mkdir()
    path = on_file(client, tmp_path / "other" / "robot.yaml")
    text = path.read_text()
    client.add_topic(MAP).result(60)
    with pytest.raises(EngineError, match=pattern(Unable.SAVED_ELSEWHERE)):
        client.do(Save()).result(60)
    assert path.read_text() == text
