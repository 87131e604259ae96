"""Operators of a session: an engine that runs lets in whom its file names, and nobody else after a reload."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support.operators import Reachable
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.file_form import as_said
from rsb_bridge.config.keys import copy_key, read_key, write_key
from rsb_bridge.config.session_file import load, save
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Operator, Session, session_keys
from rsb_bridge.ros.no_ros import NoRos

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.control import Machine


class Robot:
    """A server that runs without a ROS domain, and its session file."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "robot1.yaml"
        self.anna, self.bob = write_key(folder / "anna.key"), write_key(folder / "bob.key")
        write_key(folder / "key.txt")
        operators = (Operator("anna", "anna.key", "change"), Operator("bob", "bob.key"))
        self.session = Session(
            name="robot1",
            role="server",
            server_ip="127.0.0.1",
            server_port=free_port(),
            key_file="key.txt",
            shutdown_topic=None,
            features=as_said({name: None for name, key in session_keys().items() if key.own_topic}),
            operators=operators,
        )
        save(self.session, self.path)
        self.engine = Engine(self.session, base=folder, ros=NoRos())
        self.engine.use_file(self.path)

    def start(self, machine: Machine) -> Reachable:
        self.engine.start()
        return Reachable(machine, self.engine, self.engine.access)

    def change(self, *operators: Operator) -> None:
        """Name other operators in the file, and have it read again."""
        save(msgspec.structs.replace(self.session, operators=operators), self.path)
        self.engine.reload().result(60)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    made = Robot(tmp_path)
    yield made
    made.engine.stop()


def test_named_operators_attach_until_they_are_removed(machine: Machine, robot: Robot) -> None:
    reachable = robot.start(machine)
    anna, bob = reachable.attach("anna", robot.anna), reachable.attach("bob", robot.bob)
    assert (anna.read_only, bob.read_only) == (False, True)
    anna.retry().result(60)
    (done,) = [event for event in robot.engine.events() if event.code == EventCode.OPERATOR_RETRIED]
    assert done.who.startswith("anna (operator key)")
    robot.change(Operator("bob", "bob.key", "change"))
    eventually(lambda: anna.unreachable)
    eventually(lambda: not bob.unreachable and not bob.read_only, what="bob has attached again, and may more")
    assert [each.name for each in robot.engine.session.operators] == ["bob"]
    with pytest.raises(EngineError):
        reachable.attach("anna", robot.anna)


def test_a_dry_run_only_says_what_would_change(machine: Machine, robot: Robot) -> None:
    reachable = robot.start(machine)
    anna = reachable.attach("anna", robot.anna)
    granted = robot.engine.access.granted
    save(msgspec.structs.replace(robot.session, operators=()), robot.path)
    said = robot.engine.reload(dry_run=True).result(60).changed
    assert [text.partition(":")[0] for text in said] == ["operator anna", "operator bob"]
    assert robot.engine.access.granted is granted
    anna.retry().result(60)


def test_replaced_key_detaches_new_one_attaches(machine: Machine, robot: Robot) -> None:
    reachable = robot.start(machine)
    anna = reachable.attach("anna", robot.anna)
    new = write_key(robot.path.with_name("anna.key"), force=True)
    robot.change(*robot.session.operators)
    eventually(lambda: anna.unreachable)
    reachable.attach("anna", new)


def test_reload_with_key_of_somebody_else_changes_nothing(machine: Machine, robot: Robot) -> None:
    reachable = robot.start(machine)
    anna = reachable.attach("anna", robot.anna)
    copy_key(read_key(robot.path.with_name("key.txt")), robot.path.with_name("bob.key"), force=True)
    with pytest.raises(EngineError, match="bob"):
        robot.engine.reload().result(60)
    anna.retry().result(60)
    assert load(robot.path) == robot.session


@pytest.mark.parametrize("other", ["key.txt", "anna.key"])
def test_engine_refuses_operator_with_anothers_key(robot: Robot, other: str) -> None:
    copy_key(read_key(robot.path.with_name(other)), robot.path.with_name("bob.key"), force=True)
    with pytest.raises(EngineError, match="bob"):
        robot.engine.start()


def test_client_with_operators_key_is_refused(robot: Robot) -> None:
    robot.engine.start()
    with pytest.raises(EngineError, match="anna"):
        robot.engine.add_client(Client("robot2", key_file="anna.key")).result(60)
    robot.path.with_name("anna.key").unlink()  # the engine has read it long ago
    write_key(robot.path.with_name("robot2.key"))
    robot.engine.add_client(Client("robot2", key_file="robot2.key")).result(60)


def test_file_that_others_may_read_is_warned_of(robot: Robot) -> None:
    robot.path.with_name("anna.key").chmod(0o644)
    robot.engine.start()
    assert any(event.code == EventCode.KEY_WARNING and "anna.key" in event.text for event in robot.engine.events())
