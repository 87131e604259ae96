"""Two bridges over a socket: a robot with units, and the other side that sees them and asks for them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support.bridge import connections, happened, linked, reloaded
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import save
from rsb_bridge.feature import MAY
from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Client, Topic
from rsb_extras.units.tests.supervised import Supervised, has, may, waiting
from rsb_extras.units.unit_records import UnitOutcome, UnitRecord, UnitState
from rsb_extras.units.unit_requests import ControlUnit, ListUnits, UnitGroup
from rsb_extras.units.unit_runner import STARTS, UnitCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


@pytest.fixture
def nav(tmp_path: Path) -> Iterator[Supervised]:
    unit = Supervised(tmp_path / "nav", nodes=("/planner_server",))
    yield unit
    unit.close()


def two_sides(bridge: Bridge, nav: Supervised, *names: str, **others: Any) -> tuple[Engine, Engine]:
    """Return the control PC, and the robot that lets it ask for some units."""
    given = {MAY: may(*names)} if names else {}
    robot = bridge.client(*others.pop("topics", ()), features=has(("nav", nav), **given), **others)
    pc = bridge.server(**others)
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    return pc, robot


def listed(engine: Engine) -> tuple[UnitGroup, ...]:
    return engine.do(ListUnits()).result(60)


def nav_of(engine: Engine) -> UnitRecord:
    (group,) = listed(engine)
    (record,) = group.units
    return record


def ask(engine: Engine, action: Any = "restart", unit: str = "nav", link: str = "robot1") -> UnitOutcome:
    return engine.do(ControlUnit(unit, action, link)).result(60)


def test_a_unit_is_started_restarted_and_stopped_from_there(bridge: Bridge, nav: Supervised) -> None:
    pc, robot = two_sides(bridge, nav, "nav")
    assert (nav_of(pc).state, nav_of(pc).allowed) == (UnitState.STOPPED, True)
    assert nav_of(pc).actions == ("start", "stop", "restart")
    assert listed(pc)[0].link == "robot1"
    assert listed(robot)[0].link == ""
    with acting("anna on pts/3"):
        began = ask(pc, "start")
    assert (began.done, began.state) == (True, UnitState.RUNNING)
    first = nav.pid
    with acting("anna on pts/3"):
        again = ask(pc)
    assert (again.done, again.refused, again.reason, again.log) == (True, False, "", ())
    assert nav.pid != first
    os.kill(nav.pid, 0)  # it runs
    assert nav_of(pc).state is UnitState.RUNNING, "the end of an action has found the state"
    assert ask(pc, "stop").state is UnitState.STOPPED
    assert nav.ran == ["start", "restart", "stop"]
    event = happened(robot, UnitCode.ENDED, "unit nav: restart: it came back in ")
    assert event is not None
    assert (event.from_peer, event.link) == (True, "robot1")
    assert event.who == "the server, which says: anna on pts/3"
    assert happened(pc, UnitCode.BEGAN, "unit nav of robot1: restart asked for by anna on pts/3")
    assert happened(pc, UnitCode.ENDED, "unit nav of robot1: restart: it came back in ")


def test_a_unit_that_does_not_come_back_sends_its_logs_end(bridge: Bridge, nav: Supervised) -> None:
    pc, robot = two_sides(bridge, nav, "nav")
    ask(pc, "start")
    nav.breaks()
    outcome = ask(pc)
    assert (outcome.done, outcome.reason) == (False, "restart ended with exit code 7")
    assert outcome.output == ("no device",)
    assert outcome.log == ("started", "cannot open /dev/lidar")
    assert happened(robot, UnitCode.FAILED, "exit code 7")
    assert happened(pc, UnitCode.FAILED, "exit code 7")


def test_a_unit_that_dies_at_once_did_not_come_back(bridge: Bridge, nav: Supervised) -> None:
    start = ("sh", "-c", f"echo 1 > {nav.folder}/log; echo 4194304 > {nav.folder}/pid")  # no process has that number
    nav.unit = msgspec.structs.replace(nav.unit, start=start)
    pc, _ = two_sides(bridge, nav, "nav")
    outcome = ask(pc, "start")
    assert (outcome.done, outcome.state, outcome.log) == (False, UnitState.FAILED, ("1",))
    assert outcome.reason.startswith("start is done, but the unit is failed after ")


def test_a_unit_that_takes_too_long_is_ended(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder), timeout=1.0)
    pc, _ = two_sides(bridge, nav, "nav")
    assert ask(pc, "start").reason == "it took longer than 1 s, and was ended"


def test_commands_never_leave_their_side(bridge: Bridge, nav: Supervised) -> None:
    """Nor do the names of nodes, in what crosses and in what a console elsewhere gets."""
    pc, _ = two_sides(bridge, nav, "nav")
    ask(pc, "start")
    seen = msgspec.json.encode(listed(pc)) + msgspec.json.encode([event.text for event in pc.events()])
    assert b"supervise" not in seen
    assert b"planner_server" not in seen


def test_without_the_right_the_other_side_only_looks(bridge: Bridge, nav: Supervised, tmp_path: Path) -> None:
    lidar = Supervised(tmp_path / "lidar")
    robot = bridge.client(features=has(("nav", nav), ("lidar", lidar), **{MAY: may("lidar")}))
    pc = bridge.server()
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    records = {record.name: record for record in listed(pc)[0].units}
    assert {name: record.allowed for name, record in records.items()} == {"nav": False, "lidar": True}
    outcome = ask(pc)
    assert outcome.refused
    reason = "robot1 does not let the server restart unit nav: add may: {units: [nav]}"
    assert outcome.reason.startswith(reason)
    assert happened(robot, UnitCode.REFUSED, reason)
    assert happened(pc, UnitCode.REFUSED, reason)
    assert ask(pc, unit="lidar").done
    assert (nav.ran, lidar.ran) == ([], ["restart"])
    lidar.close()
    assert ask(robot, link="").done, "an operator of the robot needs no right"


def test_a_reload_gives_and_takes_the_right(bridge: Bridge, nav: Supervised, tmp_path: Path) -> None:
    pc, robot = two_sides(bridge, nav)
    path = tmp_path / "robot1.yaml"
    save(robot.session, path)
    assert ask(pc).refused
    reloaded(robot, path, features=has(("nav", nav), **{MAY: may("nav")}))
    assert ask(pc).done
    reloaded(robot, path, features=has(("nav", nav)))
    assert ask(pc).refused
    reloaded(robot, path, features={})
    assert listed(pc) == ()
    assert nav.ran == ["restart"]


def test_a_server_has_units_too(bridge: Bridge, nav: Supervised) -> None:
    server = bridge.server(features=has(("nav", nav), **{MAY: may("nav")}))
    client = bridge.client()
    eventually(lambda: linked(client) and linked(server), what="linked")
    assert ask(client).done
    assert nav.ran == ["restart"]


def test_one_action_runs_at_a_time(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder), status=())
    pc, robot = two_sides(bridge, nav, "nav")
    first = pc.do(ControlUnit("nav", "start", "robot1"))
    eventually(lambda: nav.ran, what="a command that runs")
    assert nav_of(robot).doing == "start"
    assert ask(pc, "stop").reason == "a unit is being changed there already: wait until that is over"
    (nav.folder / "go").touch()
    assert first.result(60).done
    assert nav.ran == ["waits"]


def test_an_own_operator_ends_a_peers_action(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder))
    pc, robot = two_sides(bridge, nav, "nav")
    first = pc.do(ControlUnit("nav", "start", "robot1"))
    eventually(lambda: nav.ran, what="a command that runs")
    assert ask(robot, "stop", link="").done
    assert nav.ran == ["waits", "stop"]
    reason = "an operator of its side ended it, for another action"
    assert (first.result(60).done, first.result().reason) == (False, reason)
    assert happened(robot, UnitCode.FAILED, f"unit nav: start: {reason}")
    assert happened(pc, UnitCode.FAILED, reason)
    (nav.folder / "ran").unlink()
    robot.do(ControlUnit("nav", "start"))
    eventually(lambda: nav.ran, what="a command that runs")
    for side, link in ((robot, ""), (pc, "robot1")):
        assert ask(side, "stop", link=link).reason == "a unit is being changed there already: wait until that is over"


def test_a_missing_programs_path_stays_here(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, start=("/opt/secret/nav",))
    pc, robot = two_sides(bridge, nav, "nav")
    reason = "its program cannot be run: No such file or directory; the log of its side names it"
    assert ask(pc, "start").reason == reason
    assert happened(robot, UnitCode.FAILED, f"unit nav: start: {reason} (/opt/secret/nav)")
    assert not any("secret" in event.text for event in pc.events())


def test_lists_do_not_hinder_actions(bridge: Bridge, nav: Supervised) -> None:
    """Screens ask for the units all the time: no list makes the ticket of an action void."""
    nav.unit = msgspec.structs.replace(nav.unit, status=(), restart=("true",))
    pc, _ = two_sides(bridge, nav, "nav")
    for _ in range(STARTS):
        lists = [pc.do(ListUnits()) for _ in range(2)]
        action = pc.do(ControlUnit("nav", "restart", "robot1"))
        lists += [pc.do(ListUnits()) for _ in range(2)]
        assert action.result(60).done
        for each in lists:
            each.result(60)


def test_actions_are_counted_for_each_side(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, status=(), restart=("true",))
    pc, robot = two_sides(bridge, nav, "nav")
    assert [ask(pc).refused for _ in range(STARTS + 2)] == [False] * STARTS + [True] * 2
    assert "6 times within 60 s" in ask(pc).reason
    assert [ask(robot, link="").refused for _ in range(STARTS + 1)] == [False] * STARTS + [True]


def test_an_armed_unit_is_left_alone(
    bridge: Bridge, nav: Supervised, robot: Domain, pc: Domain, consoles: Consoles, long_lease: None
) -> None:
    motor = robot.node.get_fully_qualified_name()
    robot.listener("/cmd")
    pc.publisher("/cmd")
    command = Topic("/cmd", "receive", arm=True)
    nav.unit = msgspec.structs.replace(nav.unit, nodes=(motor,))
    there, here = two_sides(bridge, nav, "nav", topics=(command,))
    consoles.arm(there)
    outcome = ask(there)
    assert outcome.refused
    assert outcome.reason == (
        "/cmd is armed, and a node of unit nav takes it: disarm it first, or ask an operator of that side"
    )
    assert nav.ran == []
    assert ask(here, link="").done, "the robot's own operator may"
    there.disarm(_key(there)).result(60)
    eventually(lambda: ask(there).done, what="a restart once it is disarmed")


def test_only_what_concerns_a_units_nodes_counts(
    bridge: Bridge, nav: Supervised, robot: Domain, pc: Domain, consoles: Consoles, long_lease: None, tmp_path: Path
) -> None:
    robot.listener("/cmd")
    pc.publisher("/cmd")
    unknown = Supervised(tmp_path / "unknown")
    units = has(("nav", nav), ("unknown", unknown), **{MAY: may("nav", "unknown")})
    client = bridge.client(Topic("/cmd", "receive", arm=True), features=units)
    server = bridge.server()
    eventually(lambda: linked(server) and linked(client), what="linked")
    consoles.arm(server)
    assert ask(server).done, "its nodes are others"
    outcome = ask(server, unit="unknown")
    assert outcome.reason.startswith("/cmd is armed, and unit unknown lists no nodes")
    assert unknown.ran == []


def test_a_refusal_names_no_topic_of_another_link(
    bridge: Bridge, nav: Supervised, robot: Domain, pc: Domain, consoles: Consoles, long_lease: None
) -> None:
    """The server's unit lists no nodes; another robot's topic is armed."""
    robot.listener("/cmd")
    pc.publisher("/robot1/cmd")
    nav.unit = msgspec.structs.replace(nav.unit, nodes=())
    right = {MAY: may("nav")}
    clients = (Client("robot1", use_name=True, features=right), Client("robot2", use_name=True, features=right))
    server = bridge.server(name="pc", clients=clients, shared_keys=True, features=has(("nav", nav)))
    first = bridge.client(Topic("/cmd", "receive", arm=True))
    second = bridge.client(name="robot2")
    eventually(lambda: all(link.linked for link in inside(server).links()), what="both links")
    consoles.arm(server, "/robot1/cmd")
    reason = "is armed, and unit nav lists no nodes"
    assert ask(second, link="robot2").reason.startswith(f"something {reason}")
    assert ask(first).reason.startswith(f"/robot1/cmd {reason}")
    assert nav.ran == []


def test_an_action_asked_for_while_away_is_not_too_late(bridge: Bridge, nav: Supervised, relay: Relay) -> None:
    """What the lost connection took along crosses on the next one, once."""
    bridge.through(relay)
    nav.unit = msgspec.structs.replace(nav.unit, status=(), restart=("true",))
    pc, _ = two_sides(bridge, nav, "nav", outlive=60.0)
    relay.hold()
    action = pc.do(ControlUnit("nav", "restart", "robot1"))
    eventually(lambda: happened(pc, UnitCode.BEGAN), what="a request that is on its way")
    relay.cut()
    relay.release()
    assert action.result(60).done


def _key(engine: Engine) -> str:
    return next(each.key for each in engine.snapshot().routes if each.topic == "/cmd")


def test_the_end_of_the_bridge_ends_the_command(bridge: Bridge, nav: Supervised) -> None:
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder))
    robot = bridge.client(features=has(("nav", nav)))
    others = _children()
    robot.do(ControlUnit("nav", "start"))
    eventually(lambda: nav.ran, what="a command that runs")
    assert _children() - others
    robot.stop()
    eventually(lambda: not _children() - others, what="no process of it")


def _children() -> set[str]:
    """Return the processes that any thread of this one has started, those of other tests too."""
    return {each for thread in Path("/proc/self/task").iterdir() for each in (thread / "children").read_text().split()}


def test_an_action_outlives_a_lost_connection(bridge: Bridge, nav: Supervised, relay: Relay) -> None:
    """Its end comes over the next connection; nothing is asked a second time."""
    bridge.through(relay)
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder), status=())
    pc, _ = two_sides(bridge, nav, "nav", outlive=60.0)
    first = pc.do(ControlUnit("nav", "start", "robot1"))
    eventually(lambda: nav.ran, what="a command that runs")
    before = connections(pc)
    relay.cut()
    eventually(lambda: connections(pc) > before, what="another connection")
    (nav.folder / "go").touch()
    assert first.result(60).done
    assert nav.ran == ["waits"]


@pytest.mark.parametrize("ends", ["before", "after"])
def test_an_actions_end_comes_over_a_lost_link(bridge: Bridge, nav: Supervised, relay: Relay, ends: str) -> None:
    """A unit that is restarted may be what the link needs: the other side asks again by its ticket."""
    bridge.through(relay)
    nav.unit = msgspec.structs.replace(nav.unit, start=waiting(nav.folder), status=())
    pc, robot = two_sides(bridge, nav, "nav", outlive=0.0)
    first = pc.do(ControlUnit("nav", "start", "robot1"))
    eventually(lambda: nav.ran, what="a command that runs")
    relay.refuse()
    eventually(lambda: not linked(pc) and not linked(robot), what="a lost link")
    with pytest.raises(EngineError, match="robot1 is not linked"):
        ask(pc)
    if ends == "before":
        (nav.folder / "go").touch()
        eventually(lambda: happened(robot, UnitCode.ENDED), what="its end")
    relay.refuse(refuses=False)
    eventually(lambda: linked(pc), what="linked again")
    (nav.folder / "go").touch()
    assert first.result(60).done
    assert nav.ran == ["waits"]


def test_states_are_looked_for_only_while_somebody_asks(bridge: Bridge, nav: Supervised) -> None:
    status = ("sh", "-c", f"echo status >> {nav.folder}/ran; exit 3")
    nav.unit = msgspec.structs.replace(nav.unit, status=status)
    pc, robot = two_sides(bridge, nav, "nav")
    assert nav.ran == []
    began = inside(robot).context.now()
    for _ in range(20):
        listed(pc)
    spent = inside(robot).context.now() - began
    assert 1 <= len(nav.ran) <= 1 + spent / 5


def test_a_side_that_is_not_linked_is_named(bridge: Bridge) -> None:
    (side,) = bridge.server().do(ListUnits()).result(60)
    assert side.problem.startswith("not linked: "), "those who show it name the side"
