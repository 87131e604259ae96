"""A change for many robots: what it would be, one after the other, where it stops, and the way back."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.changing import ChangingEngine
from tests.console.scripted import ScriptedEngine, refused
from tests.support.fleet import robot, topics

from rsb_bridge.api import NoAnswerError
from rsb_bridge.model.commands import EditTopic
from rsb_bridge.model.robot_summary import RobotState
from rsb_bridge.model.session import Topic
from rsb_extras.fleet.rolling import PATIENCE, RobotChange, Rollout, RolloutOutcome, report, said, way_back
from rsb_extras.fleet.tests.scripted_fleet import ScriptedSource, fleet_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.commands import Command, R

SETTLE = 10.0


class RefusingEngine(ScriptedEngine):
    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        super().do(command, step)
        return refused("no leave")


class LosingEngine(ScriptedEngine):
    """Loses the connection before its answer.

    Args:
        bed: where it is.
        then: what has become of the command.
    """

    def __init__(self, bed: Bed, then: str) -> None:
        super().__init__(routes=bed.source.engines["robot1"].now.routes)
        self.bed, self.then = bed, then

    def do(self, command: Command[R], step: Any = None) -> Future[R]:
        assert isinstance(command, EditTopic)
        if self.then == "done":
            changed = (replace(each, spec=command.topic) for each in self.now.routes if each.key == command.key)
            self.now = replace(self.now, routes=tuple(changed))
        elif self.then == "unknown":
            del self.bed.source.engines["robot1"]
        lost: Future[R] = Future()
        lost.set_exception(NoAnswerError("no answer: the connection ended"))
        return lost


class Bed:
    """Some robots, and a clock that a test moves.

    Args:
        names: of the robots; each has a scan and a camera.
    """

    def __init__(self, *names: str) -> None:
        self.source = ScriptedSource(*(robot(name) for name in names))
        for name in names:
            routes = topics(name, Topic("/scan", "transmit"), Topic("/camera", "transmit", max_rate=30.0))
            self.source.engines[name] = ScriptedEngine(routes=routes)
        self.fleet = fleet_of(self.source)
        self.now = 0.0
        self.meanwhile: Callable[[], None] = lambda: None
        self.told: list[tuple[str, str]] = []

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.meanwhile()

    def rollout(self, topic: str, *keys: str, settle: float = SETTLE) -> Rollout:
        robots = self.fleet.chosen([], everyone=True)
        return Rollout(self.fleet, robots, topic, keys, settle, now=lambda: self.now, sleep=self.sleep)

    def run(self, topic: str, *keys: str) -> tuple[Rollout, RolloutOutcome]:
        rollout = self.rollout(topic, *keys)
        return rollout, rollout.run(rollout.plan(), self.tell)

    def tell(self, step: RobotChange, what: str) -> None:
        self.told.append((step.name, what))

    def commands(self, name: str) -> list[Any]:
        return self.source.engines[name].commands


def names(steps: list[RobotChange]) -> list[str]:
    return [step.name for step in steps]


def test_what_it_would_change() -> None:
    bed = Bed("robot1", "robot2", "robot3", "robot4")
    engines = bed.source.engines
    engines["robot2"].now = replace(
        engines["robot2"].now, routes=topics("robot2", Topic("/camera", "receive", max_rate=5))
    )
    engines["robot3"].now = replace(engines["robot3"].now, routes=topics("robot3", Topic("/camera_left", "receive")))
    del engines["robot4"]
    one, two, three, four = bed.rollout("/camera", "max_rate=5", "compression=zstd").plan()
    assert one.changes == ("compression none → zstd", "max_rate 30.0 → 5")
    assert two.changes == ("compression none → zstd",)
    assert (three.new, four.new) == (None, None)
    assert "/camera_left" in three.problem
    assert "does not answer" in four.problem
    assert said(one) == "compression none → zstd, max_rate 30.0 → 5"
    assert not any(bed.commands(name) for name in engines)
    (same, *_) = bed.rollout("/camera", "max_rate=30").plan()
    assert (same.new, same.problem, said(same)) == (None, "", "nothing to change")


@pytest.mark.parametrize("undoes", [False, True])
def test_what_somebody_has_changed_since_is_not_overwritten(undoes: bool) -> None:
    bed = Bed("robot1")
    engine = bed.source.engines["robot1"] = ChangingEngine()
    rollout = bed.rollout("/scan", "max_rate=2")
    steps = rollout.plan()
    if undoes:
        outcome = rollout.run(steps, bed.tell)
    engine.put("/scan", msgspec.structs.replace(engine.spec("/scan"), paused=True))
    failed = rollout.undo(outcome, bed.tell) if undoes else rollout.run(steps, bed.tell).failed
    assert failed
    assert engine.spec("/scan").paused


@pytest.mark.parametrize("key", ["max_rate", "speed=5", "max_rate=fast", "direction=receive"])
def test_what_is_no_change(key: str) -> None:
    (step,) = Bed("robot1").rollout("/camera", key).plan()
    assert step.problem
    assert step.new is None


def test_a_topic_both_ways_is_not_clear() -> None:
    bed = Bed("robot1")
    engine = bed.source.engines["robot1"]
    engine.now = replace(engine.now, routes=topics("robot1", Topic("/tf", "receive"), Topic("/tf", "transmit")))
    (step,) = bed.rollout("/tf", "max_rate=5").plan()
    assert step.new is None
    assert "2 times" in step.problem


def test_one_after_the_other() -> None:
    bed = Bed("robot1", "robot2")
    rollout, outcome = bed.run("/camera", "max_rate=5")
    assert names(outcome.done) == ["robot1", "robot2"]
    assert (outcome.failed, outcome.left) == (None, [])
    assert bed.told == [
        (name, what) for name in ("robot1", "robot2") for what in ("changing", "settling", "done")
    ]  # fmt: skip
    ((what, key, topic),) = bed.commands("robot2")
    assert (what, key, topic.max_rate) == ("edit", "robot2 /camera", 5.0)
    assert 2 * SETTLE <= bed.now < 2 * SETTLE + 3
    assert rollout.undo(outcome, bed.tell) == []
    assert [each[2].max_rate for each in bed.commands("robot1")] == [5.0, 30.0]


def test_it_stops_at_the_first_that_gets_worse() -> None:
    bed = Bed("robot1", "robot2", "robot3")

    def meanwhile() -> None:
        if len(bed.commands("robot2")) == 1:
            bed.source.put("robot2", state=RobotState.FAULT, why="/camera DOWN: refused")

    bed.meanwhile = meanwhile
    rollout, outcome = bed.run("/camera", "max_rate=5")
    assert (names(outcome.done), names(outcome.left)) == (["robot1"], ["robot3"])
    assert outcome.failed is not None
    assert (outcome.failed.name, outcome.was_changed) == ("robot2", True)
    assert "/camera DOWN: refused" in outcome.why
    assert bed.commands("robot3") == []
    assert names(outcome.changed) == ["robot2", "robot1"]
    (back,) = way_back(rollout, outcome)
    assert back.endswith(": rsb-console fleet edit robot2 robot1 /camera max_rate=30")
    text = "\n".join(report(rollout, outcome))
    assert "stopped at robot2" in text
    assert "not begun: robot3" in text
    rollout.undo(outcome, bed.tell)
    assert [each[2].max_rate for each in bed.commands("robot2")] == [5.0, 30.0]


def test_a_short_fault_is_forgiven() -> None:
    """Nothing flows while a topic is opened again."""
    bed = Bed("robot1")

    def meanwhile() -> None:
        worse = bed.commands("robot1") and 1.0 < bed.now < SETTLE - 1
        bed.source.put("robot1", state=RobotState.FAULT if worse else RobotState.OK, flowing=2 if bed.now < 12 else 3)

    bed.meanwhile = meanwhile
    _, outcome = bed.run("/camera", "max_rate=5")
    assert names(outcome.done) == ["robot1"]
    assert bed.now == pytest.approx(12 + SETTLE, abs=1)


def test_a_topic_that_does_not_come_back() -> None:
    bed = Bed("robot1", "robot2")
    bed.meanwhile = lambda: bed.source.put("robot1", flowing=2)
    _, outcome = bed.run("/camera", "max_rate=5")
    assert outcome.failed is not None
    assert "2 of 3" in outcome.why
    assert bed.now == pytest.approx(SETTLE + PATIENCE, abs=1)


def test_one_that_changes_all_time_does_not_settle() -> None:
    bed = Bed("robot1")
    bed.meanwhile = lambda: bed.source.put("robot1", state=RobotState.WARN if bed.now % 6 < 2 else RobotState.OK)
    _, outcome = bed.run("/camera", "max_rate=5")
    assert outcome.failed is not None
    assert bed.now == pytest.approx(SETTLE + PATIENCE, abs=1)


def test_paused_topic_flows_no_more_on_purpose() -> None:
    bed = Bed("robot1")
    bed.meanwhile = lambda: bed.source.put("robot1", flowing=2)
    _, outcome = bed.run("/camera", "paused=true")
    assert names(outcome.done) == ["robot1"]


def test_robot_bad_before_does_not_stop_rollout() -> None:
    bed = Bed("robot1", "robot2")
    bed.source.put("robot1", state=RobotState.FAULT, why="/scan DOWN")
    _, outcome = bed.run("/camera", "max_rate=5")
    assert sorted(names(outcome.done)) == ["robot1", "robot2"]


def test_a_refusal_stops_it() -> None:
    bed = Bed("robot1", "robot2")
    bed.source.engines["robot1"] = RefusingEngine(routes=bed.source.engines["robot1"].now.routes)
    rollout, outcome = bed.run("/camera", "max_rate=5")
    assert (outcome.failed is not None, outcome.was_changed, outcome.why) == (True, False, "no leave")
    assert (outcome.changed, names(outcome.left)) == ([], ["robot2"])
    assert [*way_back(rollout, outcome)] == []


@pytest.mark.parametrize(("then", "was_changed"), [("done", True), ("unknown", None), ("not done", False)])
def test_robot_with_lost_answer_is_asked_again(then: str, was_changed: bool | None) -> None:
    """The rollout's undo must not leave it out."""
    bed = Bed("robot1", "robot2")
    bed.source.engines["robot1"] = LosingEngine(bed, then)
    _, outcome = bed.run("/camera", "max_rate=5")
    assert (outcome.failed is not None, outcome.was_changed) == (True, was_changed)
    assert (names(outcome.changed), names(outcome.left)) == ([] if was_changed is False else ["robot1"], ["robot2"])


def test_a_topic_that_is_gone_meanwhile_stops_it() -> None:
    bed = Bed("robot1")
    rollout = bed.rollout("/camera", "max_rate=5")
    steps = rollout.plan()
    bed.source.engines["robot1"].now = replace(bed.source.engines["robot1"].now, routes=())
    outcome = rollout.run(steps, bed.tell)
    assert (outcome.failed is not None, outcome.was_changed) == (True, False)


def test_an_operator_stops_it() -> None:
    bed = Bed("robot1", "robot2")
    rollout = bed.rollout("/camera", "max_rate=5")

    def tell(_: RobotChange, what: str) -> None:
        rollout.cancelled = what == "settling" or rollout.cancelled

    outcome = rollout.run(rollout.plan(), tell)
    assert (names(outcome.done), outcome.failed, names(outcome.left)) == (["robot1"], None, ["robot2"])
    assert outcome.why


def test_what_cannot_be_put_back_is_said() -> None:
    bed = Bed("robot1", "robot2")
    rollout, outcome = bed.run("/camera", "max_rate=5")
    del bed.source.engines["robot2"]
    ((step, why),) = rollout.undo(outcome, bed.tell)
    assert (step.name, why) == ("robot2", "robot2 does not answer")
    assert [each[2].max_rate for each in bed.commands("robot1")] == [5.0, 30.0]
