"""A fleet over a real Zenoh router: engines that announce themselves, and an operator's console that finds them."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.console.scripted import SESSION, ScriptedEngine
from tests.support.control import Machine
from tests.support.operators import ANNA, BOB, granted
from tests.support.waiting import eventually
from tests.support.zenoh_router import Router, stranger

from rsb_bridge.access import Access
from rsb_bridge.api import EngineError
from rsb_bridge.config.fleet_file import FleetFile
from rsb_bridge.control.client import RemoteEngine
from rsb_bridge.control.over_zenoh import Announcement, FleetWay
from rsb_bridge.control.summaries import Summaries
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.robot_summary import RobotState, decode
from rsb_bridge.model.session import ZenohSettings
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.transport.zenoh.network import Network
from rsb_console.fleet.zenoh import ZenohFleet

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.control.server import ControlServer
    from rsb_bridge.model.robot_summary import RobotSummary


class Fleet:
    """Engines in one network, and consoles of operators.

    Attributes:
        router: of the network.
        engines: by name.
        servers: by name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.engines: dict[str, ScriptedEngine] = {}
        self.servers: dict[str, ControlServer] = {}
        self._resources = ExitStack()
        self.router = Router()
        self._resources.callback(self.router.close)

    @property
    def settings(self) -> ZenohSettings:
        return ZenohSettings((self.router.endpoint,), fleet="lab")

    def add(self, name: str, *, host: str = "robot") -> None:
        """Announce an engine; of a second one of a name, `host` tells its socket from the first one's."""
        folder = self.folder / host
        folder.mkdir(exist_ok=True)
        engine = ScriptedEngine(msgspec.structs.replace(SESSION, name=name))
        machine = Machine(folder)
        server = machine.serve(engine)
        access = Access(name, EventLog(Clock()), Clock())
        access.grant(granted("anna", ANNA) | granted("bob", BOB, "look"))
        network = Network(self.settings, folder)
        Announcement(server, access, network)
        self._resources.callback(machine.close)
        self._resources.callback(network.close)
        self.engines[name], self.servers[name] = engine, server

    def file(self, operator: str = "anna", key: Key = ANNA) -> FleetFile:
        return FleetFile(self.settings, operator, key, self.folder)

    def seen_by(self, operator: str = "anna", key: Key = ANNA) -> ZenohFleet:
        """A console's fleet, started."""
        fleet = ZenohFleet(self.file(operator, key))
        fleet.start()
        self._resources.callback(fleet.stop)
        return fleet

    def attach(self, engine: str, operator: str = "anna", key: Key = ANNA) -> RemoteEngine:
        remote = RemoteEngine(FleetWay(self.file(operator, key), engine))
        remote.start()
        self._resources.callback(remote.stop)
        return remote

    def close(self) -> None:
        self._resources.close()


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


def robot(fleet: ZenohFleet, name: str) -> RobotSummary | None:
    return next((each for each in fleet.robots() if each.name == name), None)


def is_in(fleet: ZenohFleet, name: str, state: RobotState) -> bool:
    found = robot(fleet, name)
    return found is not None and found.state is state


def has_spoken(fleet: ZenohFleet, name: str) -> bool:
    found = robot(fleet, name)
    return found is not None and found.seen is not None and found.routes > 0


def test_engines_are_seen_as_they_come_and_go(fleet: Fleet) -> None:
    fleet.add("robot1")
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1"))
    assert not seen.problem
    fleet.add("robot2")
    eventually(lambda: has_spoken(seen, "robot2"))
    fleet.servers["robot1"].close()
    eventually(lambda: is_in(seen, "robot1", RobotState.MISSING))
    assert has_spoken(seen, "robot2")


def test_how_long_it_has_been_so_is_by_the_engines_own_clock(fleet: Fleet) -> None:
    fleet.add("robot1")
    own = decode(Summaries(fleet.engines["robot1"], "0.1.0")())
    assert own.seen is not None
    assert own.seen - own.since > 1
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1"))
    found = robot(seen, "robot1")
    assert found is not None
    assert found.seen is not None
    assert found.seen < own.seen  # its clock is ahead
    assert found.seen - found.since == pytest.approx(own.seen - own.since, abs=1e-3)


def test_an_operator_attaches_by_name_and_does_what_the_engine_lets_them(fleet: Fleet) -> None:
    fleet.add("robot1")
    fleet.add("robot2")
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot2"))
    fleet.attach("robot2").retry().result(60)
    assert fleet.engines["robot2"].commands == [("retry", "")]
    assert fleet.engines["robot1"].commands == []
    with pytest.raises(EngineError, match="may look only"):
        fleet.attach("robot2", "bob", BOB).retry().result(60)
    through = seen.open("robot1", read_only=True)
    through.stop()
    assert (through.bridge.name, through.read_only) == ("robot1", True)


def test_who_is_not_there_is_said_with_who_is(fleet: Fleet) -> None:
    fleet.add("robot1")
    fleet.add("robot2")
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1") and has_spoken(seen, "robot2"))
    with pytest.raises(EngineError, match=r"no engine 'robot3'.*robot1, robot2"):
        fleet.attach("robot3")
    with pytest.raises(EngineError, match=r"say which.*robot1, robot2"):
        fleet.attach("")


def test_a_wrong_key_is_said_on_the_robots_line(fleet: Fleet) -> None:
    fleet.add("robot1")
    seen = fleet.seen_by("anna", BOB)
    eventually(lambda: is_in(seen, "robot1", RobotState.FAULT))
    found = robot(seen, "robot1")
    assert found is not None
    assert "key" in found.why
    assert found.seen is None


def test_two_engines_of_a_name_are_two_lines(fleet: Fleet) -> None:
    fleet.add("robot1")
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1"))
    fleet.add("robot1", host="another")
    eventually(lambda: is_in(seen, "robot1 (2)", RobotState.WARN))
    with pytest.raises(EngineError, match="several engines are called 'robot1'"):
        fleet.attach("robot1")


def test_the_screen_says_that_the_router_is_lost_and_all_come_back(fleet: Fleet) -> None:
    fleet.add("robot1")
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1"))
    before = robot(seen, "robot1")
    assert before is not None
    fleet.router.kill()
    eventually(lambda: seen.problem)
    eventually(lambda: is_in(seen, "robot1", RobotState.MISSING))
    fleet.router.start()
    eventually(lambda: not seen.problem)
    eventually(lambda: is_in(seen, "robot1", before.state))


def test_a_network_that_is_not_there_is_said_at_once(fleet: Fleet) -> None:
    fleet.router.kill()
    with pytest.raises(EngineError, match="nobody listens there"):
        fleet.seen_by()


def test_announcements_that_are_none_are_passed_over(fleet: Fleet) -> None:
    fleet.add("robot1")
    with stranger(fleet.router) as somebody:
        live = somebody.liveliness()
        tokens = [live.declare_token(f"rsb_console/lab/here/engine/{key}") for key in ("0/-", "1/%FF", "2/client")]
        seen = fleet.seen_by()
        eventually(lambda: has_spoken(seen, "robot1"))
        assert [each.name for each in seen.robots()] == ["robot1"]
        del tokens
