"""A fleet over a real Zenoh router: engines that announce themselves, and an operator's console that finds them."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import constants, replaced
from tests.support.long import long
from tests.support.operators import ANNA, BOB, granted
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError
from rsb_bridge.control.control_sockets import ControlError, UnclearError
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.control.sealed import OperatorRefused
from rsb_bridge.control.summaries import SummaryBuilder
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.robot_summary import RobotState, decode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.trials import Trials
from rsb_extras.operators.tests import operator_places
from rsb_extras.operators.tests.zenoh_fleet import Fleet, announced
from rsb_extras.operators.zenoh_fleet import EngineChoice, FleetConnector
from rsb_extras.zenoh.pipe import PipeProblem
from rsb_extras.zenoh.sample_header import Header
from rsb_extras.zenoh.tests import zenoh_places
from rsb_extras.zenoh.tests.zenoh_attacker import TAG, Attacker
from rsb_extras.zenoh.tests.zenoh_router import stranger
from rsb_extras.zenoh.unreachable import Unreachable

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.model.robot_summary import RobotSummary
    from rsb_extras.operators.zenoh_source import ZenohFleet


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    zenoh_places.ASKED_WITHIN.set(monkeypatch, 60.0)  # of a busy router; one that is there answers sooner
    with closing(Fleet(tmp_path)) as fleet:
        yield fleet


def robot(fleet: ZenohFleet, name: str) -> RobotSummary | None:
    return next((each for each in fleet.robots() if each.name == name), None)


def is_in(fleet: ZenohFleet, name: str, state: RobotState) -> bool:
    found = robot(fleet, name)
    return found is not None and found.state is state


def has_spoken(fleet: ZenohFleet, name: str) -> bool:
    found = robot(fleet, name)
    return found is not None and found.seen is not None and found.routes > 0


def seen_with(fleet: Fleet, *names: str) -> ZenohFleet:
    """A console's fleet, which has heard these engines."""
    for name in names:
        fleet.add(name)
    seen = fleet.seen_by()
    eventually(lambda: all(has_spoken(seen, name) for name in names))
    return seen


def retry_as(fleet: Fleet, *attached: Any) -> None:
    """Attach to an engine and have it retry; again if a busy router has lost a sample, as an operator would."""
    deadline = time.monotonic() + 120
    while True:
        try:
            fleet.attach(*attached).retry().result(60)
        except ControlError as error:
            if PipeProblem.SAMPLE_LOST() not in str(error) or time.monotonic() > deadline:
                raise
        else:
            return


def test_durations_are_by_engines_own_clock(fleet: Fleet) -> None:
    fleet.add("robot1")
    own = decode(SummaryBuilder(fleet.engines["robot1"], "0.1.0")())
    assert own.seen is not None
    assert own.seen - own.since > 1
    began = time.time()
    seen = fleet.seen_by()
    eventually(lambda: has_spoken(seen, "robot1"))
    found = robot(seen, "robot1")
    assert found is not None
    assert found.seen is not None
    assert began <= found.seen <= time.time()  # by this clock, not by the engine's
    assert found.seen - found.since == pytest.approx(own.seen - own.since, abs=1e-3)


def test_operator_attaches_by_name_within_rights(fleet: Fleet) -> None:
    seen = seen_with(fleet, "robot1", "robot2")
    retry_as(fleet, "robot2")
    came = [each for each in fleet.accesses["robot2"].events.after(0) if each.code == EventCode.ATTACH_OPERATOR]
    assert "through Zenoh (id " in came[-1].text
    assert set(fleet.engines["robot2"].commands) == {("retry", "")}
    assert fleet.engines["robot1"].commands == []
    with pytest.raises(EngineError, match=pattern(OperatorRefused.READ_ONLY, name="bob")):
        retry_as(fleet, "robot2", "bob", BOB)
    through = seen.open("robot1", read_only=True)
    through.stop()
    assert (through.bridge.name, through.read_only) == ("robot1", True)


def test_absent_robot_is_told_with_present_ones(fleet: Fleet) -> None:
    seen_with(fleet, "robot1", "robot2")
    with pytest.raises(
        EngineError, match=pattern(EngineChoice.UNKNOWN, engine="robot3", known="; there are robot1 and robot2")
    ):
        fleet.attach("robot3")
    with pytest.raises(UnclearError, match="robot1 and robot2"):
        fleet.attach("")


def test_wrong_key_is_said_on_robots_line(fleet: Fleet) -> None:
    fleet.add("robot1")
    seen = fleet.seen_by("anna", BOB)
    eventually(lambda: is_in(seen, "robot1", RobotState.FAULT))
    found = robot(seen, "robot1")
    assert found is not None
    assert "key" in found.why
    assert found.seen is None


def test_two_engines_of_name_are_two_lines(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.TRIALS_OTHERS.set(monkeypatch, 60.0)  # one may prove the key much later than the other
    seen = seen_with(fleet, "robot1")
    first = fleet.servers["robot1"]
    fleet.add("robot1", host="another")
    eventually(lambda: is_in(seen, "robot1 (2)", RobotState.WARN))
    with pytest.raises(UnclearError):
        fleet.attach("robot1")
    first.close()
    eventually(lambda: has_spoken(seen, "robot1") and robot(seen, "robot1 (2)") is None)
    eventually(lambda: not is_in(seen, "robot1", RobotState.MISSING))


def test_engine_is_announced_in_networks_next_session(fleet: Fleet) -> None:
    """A link over Zenoh whose path has changed opens the network anew; the console that is attached goes on."""
    fleet.add("robot1")
    before = fleet.attach("robot1")

    def attached() -> RemoteEngine | None:
        with contextlib.suppress(ControlError):  # a busy router may answer late
            return fleet.attach("robot1")
        return None

    with stranger(fleet.router) as somebody:
        first = announced(somebody)
        asyncio.run(fleet.networks["robot1"].open(lambda: True))
        eventually(lambda: len(announced(somebody)) == 1 and announced(somebody) != first)
        eventually(attached).retry().result(60)
        before.retry().result(60)
    assert fleet.engines["robot1"].commands == [("retry", ""), ("retry", "")]


def test_lost_router_is_told_and_all_return(fleet: Fleet) -> None:
    seen = seen_with(fleet, "robot1")
    before = robot(seen, "robot1")
    assert before is not None
    fleet.router.kill()
    eventually(lambda: seen.problem)
    eventually(lambda: is_in(seen, "robot1", RobotState.MISSING))
    fleet.router.start()
    eventually(lambda: not seen.problem)
    eventually(lambda: is_in(seen, "robot1", before.state))


def test_absent_network_is_told_at_once(fleet: Fleet) -> None:
    fleet.router.kill()
    with pytest.raises(EngineError, match=pattern(Unreachable.NOBODY_LISTENS)):
        fleet.seen_by()


def test_an_engine_that_no_fleet_sees_says_so(fleet: Fleet) -> None:
    """Its links go elsewhere, and know nothing of that."""
    fleet.router.kill()
    fleet.begin("robot1")
    events = fleet.accesses["robot1"].events
    eventually(lambda: events.after(0) and events.after(0)[-1].level is Level.WARNING)
    fleet.router.start()
    eventually(lambda: events.after(0)[-1].level is Level.INFO)
    assert {each.code for each in events.after(0)} == {EventCode.ENGINE_FLEET}


def test_announcements_that_are_none_are_passed_over(fleet: Fleet) -> None:
    fleet.add("robot1")
    with stranger(fleet.router) as somebody:
        live = somebody.liveliness()
        keys = ("0/-", "1/%FF", "2/client", f"{'3' * 16}/client%200.1%20{'a' * 256}")
        tokens = [live.declare_token(f"rsb_console/lab/here/engine/{key}") for key in keys]
        seen = fleet.seen_by()
        eventually(lambda: has_spoken(seen, "robot1"))
        assert [each.name for each in seen.robots()] == ["robot1"]
        fleet.attach("").retry().result(60)  # the only engine that there is
        assert fleet.engines["robot1"].commands == [("retry", "")]
        del tokens


@pytest.mark.parametrize("name", ["*?#$%2F/ Käfer", "机" * 85], ids=ascii)
def test_name_may_be_any_that_session_may_have(fleet: Fleet, name: str) -> None:
    seen_with(fleet, name)
    fleet.attach(name).retry().result(60)
    assert fleet.engines[name].commands == [("retry", "")]


def test_console_awaits_first_word_of_engines_only(fleet: Fleet) -> None:
    for name in ("robot1", "robot2"):
        fleet.add(name)
    fleet.accesses["robot2"].grant({})
    seen = fleet.seen_by()
    seen.wait()
    assert has_spoken(seen, "robot1")
    assert is_in(seen, "robot2", RobotState.FAULT)


def test_robots_under_ever_new_names_have_budget(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    operator_places.FLEET_MOST.set(monkeypatch, 3)
    operator_places.FLEET_KEPT.set(monkeypatch, 600.0)
    seen = seen_with(fleet, "robot1")
    fleet.servers["robot1"].close()
    eventually(lambda: is_in(seen, "robot1", RobotState.MISSING))
    with stranger(fleet.router) as somebody:
        for number in range(5):
            name = f"stranger{number}"
            key = f"rsb_console/lab/here/engine/{number:016x}/client%200.1%20{name}"
            token = somebody.liveliness().declare_token(key)
            eventually(lambda name=name: robot(seen, name))
            token.undeclare()
            eventually(lambda name=name: is_in(seen, name, RobotState.MISSING))
    assert {each.name for each in seen.robots()} == {"robot1", "stranger3", "stranger4"}


@pytest.mark.parametrize("count", [30, *long(300)])
def test_engines_without_key_keep_no_operator_out(fleet: Fleet, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """To wait for one of them would take longer than any machine needs for the others."""
    constants.ANSWERS_WITHIN.set(monkeypatch, 120.0)
    replaced.FLEET_TRIALS.set(monkeypatch, functools.partial(Trials, patience=120.0))
    constants.SUMMARY_ANSWERS_WITHIN.set(monkeypatch, 600.0)
    with stranger(fleet.router) as somebody, stranger(fleet.router) as another:
        live = somebody.liveliness()
        key = "rsb_console/lab/here/engine/{:016x}/client%200.1%20robot1"
        tokens = [live.declare_token(key.format(number)) for number in range(count)]
        fleet.add("robot1")
        eventually(lambda: len(announced(another)) == count + 1)
        way = FleetConnector(fleet.file(), "robot1")
        began = time.monotonic()
        engine = RemoteEngine(way)
        engine.start()
        assert time.monotonic() - began < 60.0
        engine.retry().result(60)
        engine.stop()
        assert fleet.engines["robot1"].commands == [("retry", "")]
        assert way.unproven == count
        seen = fleet.seen_by()
        eventually(lambda: any(has_spoken(seen, each.name) for each in seen.robots()))
        del tokens


def test_namesake_engine_is_named_where_unproved(fleet: Fleet) -> None:
    with stranger(fleet.router) as somebody, stranger(fleet.router) as another:
        live = somebody.liveliness()
        key = "rsb_console/lab/here/engine/{:016x}/client%200.1%20robot1"
        tokens = [live.declare_token(key.format(number)) for number in range(3)]
        fleet.add("robot1")
        eventually(lambda: len(announced(another)) == 4)
        with pytest.raises(EngineError, match="none of 4 engines"):
            fleet.attach("robot1", "anna", BOB)
        del tokens


def is_forged(sample: Any) -> bool:
    """Whether an attacker sent it: nobody else deletes, or has this tag or text."""
    if sample.attachment is None:
        return True
    header = Header.unpack(sample.attachment.to_bytes())
    return header is None or header.tag == TAG or b"forged" in sample.payload.to_bytes()


def forged_for(somebody: Any) -> list[Any]:
    """The samples of an attacker that somebody in the network hears from now on."""
    heard: list[Any] = []

    def hear(sample: Any) -> None:
        if is_forged(sample):
            heard.append(sample)

    somebody.declare_subscriber("rsb_console/lab/**", hear)
    return heard


def test_operator_attaches_though_stranger_answers_each_stream(fleet: Fleet) -> None:
    fleet.add("robot1")
    attached: list[RemoteEngine] = []
    with stranger(fleet.router) as somebody, closing(Attacker(fleet.router.endpoint, "answers", fleet="lab")):
        forged = forged_for(somebody)

        def is_attacked() -> bool:  # not at first, if the router knows the attacker late
            attached.append(fleet.attach("robot1"))
            attached[-1].retry().result(60)
            attached[-1].stop()
            return bool(forged)

        eventually(is_attacked, what="an attack")
    assert fleet.engines["robot1"].commands == [("retry", "")] * len(attached)


@pytest.mark.parametrize("attack", ["ends", *long("windows", "following", "deletes")])
def test_an_operator_stays_attached_under_forged_samples(fleet: Fleet, attack: str) -> None:
    fleet.add("robot1")
    remote = fleet.attach("robot1")
    with stranger(fleet.router) as somebody, closing(Attacker(fleet.router.endpoint, attack, fleet="lab")):
        forged, until = forged_for(somebody), time.monotonic() + 3.0

        def stands_all() -> bool:
            remote.retry().result(60)
            assert not remote.unreachable
            return time.monotonic() > until and len(forged) > 50

        eventually(stands_all, what="3 s of the attack, and enough of it")


def test_what_operator_has_armed_is_disarmed_by_doubt(fleet: Fleet) -> None:
    """The doubt is wrong here: the console stays attached, and may arm again."""
    fleet.add("robot1")
    remote = fleet.attach("robot1")
    remote.arm("key").result(60)
    commands = fleet.engines["robot1"].commands
    with closing(Attacker(fleet.router.endpoint, "ends", fleet="lab")) as attacker:
        eventually(lambda: ("release",) in commands)
        remote.retry().result(60)
        assert not remote.unreachable
        attacker.stop()


def test_restarted_robot_keeps_its_line_and_console(fleet: Fleet) -> None:
    seen = seen_with(fleet, "robot1")
    remote = fleet.attach("robot1")
    fleet.servers["robot1"].close()
    eventually(lambda: not seen.robots(), what="it can be dismissed")
    eventually(lambda: remote.unreachable)
    fleet.add("robot1")
    eventually(lambda: has_spoken(seen, "robot1") and not is_in(seen, "robot1", RobotState.MISSING))
    assert len(seen.robots()) == 1
    eventually(lambda: not remote.unreachable)
    remote.retry().result(60)
    assert fleet.engines["robot1"].commands == [("retry", "")]


def test_operators_rights_and_keys_are_those_of_now(fleet: Fleet) -> None:
    seen = seen_with(fleet, "robot1")
    remote = fleet.attach("robot1")
    access = fleet.accesses["robot1"]
    access.grant(granted("anna", ANNA, "look"))
    eventually(lambda: remote.read_only)
    access.grant(granted("anna", BOB))
    eventually(lambda: is_in(seen, "robot1", RobotState.FAULT))
    access.grant({})
    eventually(lambda: says(remote.unreachable, OperatorRefused.UNKNOWN, name="anna"))
    access.grant(granted("anna", ANNA))
    eventually(lambda: not remote.unreachable and not remote.read_only)
