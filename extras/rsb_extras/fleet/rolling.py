"""One change of a topic for many robots: first its effect, then robot after robot, until one gets worse."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.api import NoAnswerError
from rsb_bridge.config.session_changes import changes
from rsb_bridge.feature_api import EngineError
from rsb_console.session.draft import TypedError, suggestion, typed_topic, values_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rsb_bridge.feature_api import EngineApi, RobotSummary, RouteSnapshot, Session, Topic
    from rsb_extras.fleet.fleet import Robot, RobotFleet

ANSWERED_WITHIN = 60.0  # s, as commands for one bridge: `command.target`
PATIENCE = 30.0
"""Seconds beyond the time to settle in which a robot has to become as well as before. A round figure."""
_LOOK_EVERY = 0.5  # s. A round figure: a rollout takes so much longer a robot at most


class Bridged(NamedTuple):
    """A topic of a robot."""

    robot: str
    route: RouteSnapshot
    session: Session


def bridged_by(robot: Robot) -> list[Bridged]:
    """Read a robot's topics, services, actions and parameters. This may take some seconds.

    Raises:
        EngineError: it does not answer.
    """
    with robot.source.open(robot.summary.name, read_only=True) as engine:
        return [Bridged(robot.summary.name, route, engine.session) for route in engine.snapshot().routes]


@dataclass(frozen=True, slots=True)
class RobotChange:
    """The planned change of one robot.

    Attributes:
        old: the route's present topic, or None without a route.
        new: its topic after the change, or None if nothing changes.
        changes: the fields that differ, in words.
        problem: reason why the change is impossible, or empty.
        reached: whether the robot's topics could be read.
    """

    robot: Robot
    old: Topic | None = None
    new: Topic | None = None
    changes: tuple[str, ...] = ()
    problem: str = ""
    reached: bool = True

    @property
    def name(self) -> str:
        return self.robot.summary.name

    @property
    def reversed(self) -> RobotChange:
        """The step that restores the earlier values."""
        if self.old is None or self.new is None:
            return self
        return replace(self, old=self.new, new=self.old, changes=tuple(changes(self.new, self.old)))

    def back(self, keys: Sequence[str]) -> list[str]:
        """Return the ``KEY=VALUE`` words that undo the change."""
        values = {} if self.old is None else values_of(self.old)
        names = [key.partition("=")[0] for key in keys]
        return [f"{name}={values.get(name, '')}" for name in names]


@dataclass
class RolloutOutcome:
    """The progress of a change.

    Attributes:
        done: robots that are changed and as well as before.
        failed: the robot at which it stopped, or None.
        why: reason why it stopped.
        was_changed: whether that robot has the change, or None if it may have it.
        left: robots that are not changed yet.
    """

    done: list[RobotChange] = field(default_factory=list)
    failed: RobotChange | None = None
    why: str = ""
    was_changed: bool | None = False
    left: list[RobotChange] = field(default_factory=list)

    @property
    def changed(self) -> list[RobotChange]:
        """The robots that have the change, or may have it, the last one first."""
        failed = [self.failed] if self.failed is not None and self.was_changed is not False else []
        return [*failed, *reversed(self.done)]


class Rollout:
    """A change of one topic of some robots. Every method may wait; none is for an app's thread.

    Args:
        topic: the topic's name on the robots.
        keys: ``KEY=VALUE`` each.
        settle: s that a robot has to be as well as before.
        sleep: waits so many s.
    """

    def __init__(
        self,
        fleet: RobotFleet,
        robots: Sequence[Robot],
        topic: str,
        keys: Sequence[str],
        settle: float,
        *,
        now: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.topic, self.keys = topic, list(keys)
        self._fleet, self._robots = fleet, robots
        self._settle, self._now, self._sleep = settle, now, sleep
        self.cancelled = False
        """Whether to begin no further robot; set on another thread."""

    def plan(self) -> list[RobotChange]:
        """Ask each robot for the effect of the change, without changing it. Cancelling asks no further robot."""
        return [self._planned(robot) for robot in self._robots if not self.cancelled]

    def _planned(self, robot: Robot) -> RobotChange:
        try:
            engine = robot.source.open(robot.summary.name, read_only=True)
        except EngineError as error:
            return RobotChange(robot, problem=str(error), reached=False)
        with engine:
            try:
                return self._step(robot, engine)
            except (TypedError, EngineError) as error:
                return RobotChange(robot, problem=str(error))

    def _step(self, robot: Robot, engine: EngineApi) -> RobotChange:
        routes = [route for route in engine.snapshot().routes if self.topic in (route.spec.topic, route.topic)]
        if not routes:
            known = [route.spec.topic for route in engine.snapshot().routes]
            return RobotChange(robot, problem=f"{self.topic} is not bridged{suggestion(self.topic, known)}")
        if len(routes) > 1:
            return RobotChange(
                robot, problem=f"{self.topic} is bridged {len(routes)} times: edit it on the robot itself"
            )
        old = routes[0].spec
        new = typed_topic(values_of(old), self.keys, engine.session, old)
        if new.identity != old.identity:
            return RobotChange(robot, problem="its direction cannot change: remove the topic, and add it again")
        differs = tuple(changes(old, new))
        return RobotChange(robot, old, new if differs else None, differs)

    def run(self, steps: Sequence[RobotChange], tell: Callable[[RobotChange, str], None]) -> RolloutOutcome:
        """Change one robot after the other, and stop at the first that gets worse.

        Args:
            steps: steps of `plan`; steps without a change are left out.
            tell: gets each robot and the present action in words.
        """
        left = [step for step in steps if step.new is not None]
        outcome = RolloutOutcome()
        while left:
            if self.cancelled:
                outcome.why, outcome.left = "stopped by the operator", left
                break
            step = left.pop(0)
            tell(step, "changing")
            before = self._summary(step.robot)
            try:
                self._apply(step, step.new, seen=step.old)
            except (EngineError, TimeoutError) as error:
                outcome.failed, outcome.why, outcome.left = step, str(error) or "the bridge does not answer", left
                if isinstance(error, NoAnswerError | TimeoutError):
                    outcome.was_changed = self._has_changed(step)
                break
            tell(step, "settling")
            if why := self._worse(step, before):
                outcome.failed, outcome.why, outcome.left = step, why, left
                outcome.was_changed = True
                break
            outcome.done.append(step)
            tell(step, "done")
        return outcome

    def _has_changed(self, step: RobotChange) -> bool | None:
        """Return whether a robot has its change, or None if it does not answer."""
        try:
            return any(each.route.spec == step.new for each in bridged_by(step.robot))
        except EngineError:
            return None

    def undo(self, outcome: RolloutOutcome, tell: Callable[[RobotChange, str], None]) -> list[tuple[RobotChange, str]]:
        """Restore the previous settings, the last robot first. Return the robots that failed, with the reasons."""
        failed = []
        for step in outcome.changed:
            tell(step, "putting back")
            try:
                self._apply(step, step.old, seen=step.new, drop_arm=step.new is not None and step.new.arm)
            except (EngineError, TimeoutError) as error:
                failed.append((step, str(error) or "the bridge does not answer"))
        return failed

    def _apply(self, step: RobotChange, topic: Topic | None, *, seen: Topic | None, drop_arm: bool = False) -> None:
        """Change a robot's route to a topic.

        Args:
            seen: the topic that the operator has seen; the bridge refuses to change another one.
            drop_arm: end the demand for arming, which this change made, unless the topic has it.

        Raises:
            EngineError: the bridge refuses the change.
            TimeoutError: the bridge does not answer.
        """
        assert topic is not None
        with step.robot.source.open(step.name, read_only=False) as engine:
            routes = [route for route in engine.snapshot().routes if route.spec.identity == topic.identity]
            if not routes:
                raise EngineError(f"{self.topic} is not bridged any more")
            drops = drop_arm and not topic.arm
            engine.edit_topic(routes[0].key, topic, drop_arm=drops, seen=seen).result(ANSWERED_WITHIN)

    def _worse(self, step: RobotChange, before: RobotSummary) -> str:
        """Wait until a robot has been as well as before for long enough; return the problem if it has not."""
        assert step.old is not None
        assert step.new is not None
        held = (step.new.paused, step.new.arm) != (step.old.paused, step.old.arm)
        flowing = before.flowing - held  # what is paused on purpose flows no more
        began = self._now()
        well_since = bad_since = None
        while True:
            self._sleep(min(_LOOK_EVERY, self._settle))
            now, summary = self._now(), self._summary(step.robot)
            worse = summary.state.rank < before.state.rank
            # Nothing flows for a moment while a topic is opened again: only a worse state that lasts stops the rollout.
            if worse or summary.flowing < flowing:
                well_since = None
                bad_since = (now if bad_since is None else bad_since) if worse else None
            else:
                well_since, bad_since = now if well_since is None else well_since, None
            if well_since is not None and now - well_since >= self._settle:
                return ""
            if bad_since is not None and now - bad_since >= self._settle:
                return f"{summary.state.upper()}, was {before.state.upper()}: {summary.why}"
            if now - began >= self._settle + PATIENCE:
                return (
                    f"{summary.flowing} of {summary.routes} topics flow, {before.flowing} did before"
                    if summary.flowing < flowing
                    else f"it does not become stable: {summary.why or 'its state changes all the time'}"
                )

    def _summary(self, robot: Robot) -> RobotSummary:
        found = (each.summary for each in self._fleet.robots() if each.key == robot.key)
        return next(found, robot.summary)


def said(step: RobotChange) -> str:
    """Describe the change that a step makes."""
    return step.problem or ", ".join(step.changes) or "nothing to change"


def report(rollout: Rollout, outcome: RolloutOutcome) -> Iterator[str]:
    """Report where and why a change stopped, and the robots with and without it."""
    if outcome.failed is not None:
        has_it = {True: "it has", None: "it may have"}.get(outcome.was_changed)
        its_state = f"{has_it} {' '.join(rollout.keys)}" if has_it else "it is as it was"
        yield f"stopped at {outcome.failed.name}: {outcome.why} ({its_state})"
    else:
        yield f"stopped: {outcome.why}"
    yield f"done: {names_of(outcome.done) or 'none'}"
    yield f"not begun: {names_of(outcome.left) or 'none'}"


def way_back(rollout: Rollout, outcome: RolloutOutcome) -> Iterator[str]:
    """Yield the commands that restore the previous settings."""
    over = next((way for step in outcome.changed if (way := step.robot.source.way)), "")
    by_keys: dict[str, list[str]] = {}
    for step in outcome.changed:
        by_keys.setdefault(" ".join(step.back(rollout.keys)), []).append(step.name)
    for keys, names in by_keys.items():
        yield f"to go back: rsb-console fleet edit {' '.join(names)} {rollout.topic} {keys}{over}"


def names_of(steps: Sequence[RobotChange]) -> str:
    return ", ".join(step.name for step in steps)
