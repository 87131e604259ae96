"""A Fibonacci action over an outage of so many seconds: ``python -m tests.calls.cutting 30``.

Three outages: the link is cut silently; the callers' bridge is killed (-9) and restarted; the provider's bridge is.
Each time there are three goals: one ends meanwhile, one computes all the time, and one is cancelled by its client.
What was asked waits for a link that is cut. It is lost with a bridge: then clients ask again, by the goal's id.
docs/calls.md lists what survives.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tests.support.bridge import Bridge, linked, route
from tests.support.domain import Domain
from tests.support.fibonacci import ACTION, FibonacciClient, FibonacciServer, fibonacci, id_of
from tests.support.locks import two_domains
from tests.support.program import Programs
from tests.support.relay import same_port
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.task import Future
    from tests.support.fibonacci import Goal
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.session import Session

FIBONACCI = Topic(ACTION, "receive", kind="action")
"""The robot provides it."""
_ORDER = 10_000
_EVERY = 0.1
"""s for each number of a sequence."""
_KEPT_AFTER = 60.0
"""s that a server keeps a result after the outage."""
_FORGOTTEN_AFTER = 0.2
"""s that it is kept where a client has asked for it before."""


class Came(NamedTuple):
    """The times of one outage, as its clients see them.

    Attributes:
        outage: s from its beginning to its end.
        result: s from its end to the result of the goal that ended meanwhile.
        cancel: s from its end until the client knew that its goal was cancelled.
        feedback: s from its end to the next feedback.
        numbers: of the sequence that was computed all the time, and came whole.
    """

    outage: float
    result: float
    cancel: float
    feedback: float
    numbers: int


class Scene:
    """An action server in the robot's domain, and a client in the PC's.

    Args:
        relay: is the network between them.
        programs: starts the programs that are killed.
        kept: s that the server keeps results; 0.0: it has forgotten them before the outage is over.
    """

    def __init__(self, bridge: Bridge, relay: Relay, programs: Programs, kept: float) -> None:
        self.bridge, self.relay, self.programs = bridge, relay, programs
        self.server = FibonacciServer(bridge.robot.id, result_timeout=kept or _FORGOTTEN_AFTER)
        self._keeps = bool(kept)
        self.client = FibonacciClient(bridge.pc.id)
        self.over: Goal
        self.runs: Goal
        self.unwanted: Goal
        self._numbers: tuple[int, ...] = ()
        self._computed = 0
        self._due = 0.0

    def begin(self, *engines: Engine) -> None:
        """Send all goals, and ask for their results."""
        goals = self.over, self.runs, self.unwanted = tuple(self.client.send(_ORDER).ask() for _ in range(3))
        self._numbers = tuple(self.server.number_of(goal) for goal in goals)
        for engine in engines:
            eventually(
                lambda engine=engine: [each.result_awaited for each in route(engine, ACTION).goals] == [True] * 3
            )
        self._compute_until(lambda: self.runs.feedbacks, "feedback")

    def meanwhile(self, seconds: float, cancel: Callable[[], object]) -> float:
        """Let an outage last, in which one goal ends and one is cancelled; s that it lasted."""
        began = time.monotonic()
        self.server.finish(*fibonacci(3), number=self._numbers[0])
        halfway, ends = began + seconds / 2, began + seconds
        self._compute_until(lambda: time.monotonic() > halfway, "half of it", seconds + 60.0)
        cancel()
        self._compute_until(lambda: time.monotonic() > ends, "the end", seconds + 60.0)
        if not self._keeps:
            over = id_of(self.over.handle())
            self._compute_until(lambda: over not in self.server.remembers, "the server forgets")
        assert not self.over.has_result
        return time.monotonic() - began

    def hears_again(self) -> bool:
        before = len(self.runs.feedbacks)
        self._compute_until(lambda: len(self.runs.feedbacks) > before, "feedback")
        return True

    def finishes(self) -> int:
        """End the last goal, and return the sequence that its client got."""
        sequence = fibonacci(self._computed)
        self.server.finish(*sequence, number=self._numbers[1])
        assert self.runs.result() == ("succeeded", sequence)
        self.server.finish(number=self._numbers[2], state="canceled")
        assert self.unwanted.result() == ("canceled", [])
        assert self.server.cancels == [id_of(self.unwanted.handle())]
        return len(sequence)

    def _compute_until(self, condition: Callable[[], object], what: str, within: float = 180.0) -> None:
        def met() -> bool:
            self._compute()
            return bool(condition())

        eventually(met, within, what)

    def _compute(self) -> None:
        """The next number, when it is due."""
        if time.monotonic() > self._due:
            self._due = time.monotonic() + _EVERY
            self._computed += 1
            self.server.feedback(*fibonacci(self._computed), number=self._numbers[1])

    def close(self) -> None:
        for number in self._numbers:
            self.server.finish(number=number)
        self.client.close()
        self.server.close()


def link_cut(scene: Scene, seconds: float) -> Came:
    """Nothing crosses, silently. The cancel waits, and is delivered; the node takes it in its own order."""
    engines = scene.bridge.both(FIBONACCI)
    scene.begin(*engines)
    scene.relay.stall(new=True)
    asked: list[Future] = []
    lasted = scene.meanwhile(seconds, lambda: asked.append(scene.unwanted.cancel()))
    assert not scene.server.cancels
    scene.relay.stall(False)
    ended = time.monotonic()
    later = scene.client.send(1)
    assert scene.over.result() == ("succeeded", fibonacci(3))
    result = time.monotonic() - ended
    later.handle()
    eventually(asked[0].done)
    cancel = time.monotonic() - ended
    assert sorted(scene.server.log[-2:]) == [f"cancel {id_of(scene.unwanted.handle())}", "goal 1"]
    scene.hears_again()
    feedback = time.monotonic() - ended
    came = Came(lasted, result, cancel, feedback, scene.finishes())
    scene.server.finish(1, number=3)
    assert later.ask().result() == ("succeeded", [1])
    return came


def callers_bridge_killed(scene: Scene, seconds: float) -> Came:
    """What its clients have asked is lost, as with any ROS server that dies."""
    return _bridge_killed(scene, seconds, scene.bridge.client(FIBONACCI), scene.bridge.server_session())


def providers_bridge_killed(scene: Scene, seconds: float) -> Came:
    """What clients have asked is lost, too, as the goals of another process are others."""
    return _bridge_killed(scene, seconds, scene.bridge.server(), scene.bridge.client_session(FIBONACCI))


def _bridge_killed(scene: Scene, seconds: float, engine: Engine, session: Session) -> Came:
    victim = scene.programs.start(session)
    scene.begin(engine)
    victim.kill()
    eventually(lambda: not linked(engine))
    lasted = scene.meanwhile(seconds, lambda: None)
    scene.programs.start(session)
    ended = time.monotonic()
    scene.hears_again()
    feedback = time.monotonic() - ended
    eventually(lambda: scene.client.ready, what="the services, which are discovered one by one")
    assert scene.over.ask().result() == ("succeeded", fibonacci(3))
    result = time.monotonic() - ended
    eventually(scene.unwanted.cancel().done)
    cancel = time.monotonic() - ended
    scene.runs.ask()
    scene.unwanted.ask()
    return Came(lasted, result, cancel, feedback, scene.finishes())


class Outage(NamedTuple):
    """One of the three.

    Attributes:
        happens: to a scene, for so many seconds.
        kept: whether the server keeps results for longer than that.
    """

    words: str
    happens: Callable[[Scene, float], Came]
    kept: bool


OUTAGES = (
    Outage("the link cut", link_cut, kept=False),
    Outage("the callers' bridge killed", callers_bridge_killed, kept=True),
    Outage("the provider's bridge killed", providers_bridge_killed, kept=True),
)


def happen(outage: Outage, seconds: float, robot: Domain, pc: Domain) -> Came:
    """Let one happen; AssertionError where anything is not as it should be."""
    with contextlib.ExitStack() as resources:
        bridge = Bridge(Path(resources.enter_context(tempfile.TemporaryDirectory())), robot, pc)
        programs = Programs(bridge.folder)
        resources.callback(programs.close)
        relay = same_port(bridge.port)
        resources.callback(relay.close)
        resources.callback(bridge.close)
        bridge.through(relay)
        scene = Scene(bridge, relay, programs, seconds + _KEPT_AFTER if outage.kept else 0.0)
        resources.callback(scene.close)
        return outage.happens(scene, seconds)


def main(seconds: float) -> None:
    """Have all three outages, and print what clients had."""
    domain_id = two_domains()
    robot, pc = Domain(domain_id), Domain(domain_id + 1)
    with contextlib.closing(robot), contextlib.closing(pc):
        for outage in OUTAGES:
            came = happen(outage, seconds, robot, pc)
            print(  # noqa: T201
                f"{outage.words} for {came.outage:.1f} s. After its end the result of the goal that ended meanwhile "
                f"came in {came.result:.1f} s, the answer to the cancel in {came.cancel:.1f} s, feedback of the goal "
                f"that went on in {came.feedback:.1f} s, and at its end all of its {came.numbers} numbers",
                flush=True,
            )


if __name__ == "__main__":
    main(float(sys.argv[1]))
