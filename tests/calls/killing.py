"""kill -9 of either side of a bridge in mid-call, again and again: ``python -m tests.calls.killing TIMES``.

Two bridges at once, one whose client is killed and one whose server is; their other halves live in this process, where
nothing may be left over. Two callers call all the time, so that an answer to another caller would be seen.
"""

from __future__ import annotations

import gc
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tests.calls.ledgers import balanced, called, counts, nothing_left
from tests.support.bridge import Bridge, linked
from tests.support.calls import CallNode
from tests.support.domain import Domain
from tests.support.locks import two_domains
from tests.support.program import Programs
from tests.support.resources import Resources, resources, returns_to
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.support.calls import Outcome

    from rsb_bridge.engine import Engine

_AT_ONCE = 20
_DELAY = (0.0, 0.05)
"""s until the server answers, so that calls are always in flight."""
_TIMEOUT = 5.0


class Tally(NamedTuple):
    """The counts of a run.

    Attributes:
        calls: by outcome, over all callers.
        back: s from each start of a killed side until a call was answered again.
        grown: threads, descriptors and bytes of this process, after the last kill against those after the first ones.
    """

    calls: Counter[str]
    back: list[float]
    grown: Resources


class Killing:
    """Both bridges, and who calls through them.

    Args:
        programs: runs the mortal halves.
        far: where the servers are; in the server's domain.
        callers: in the client's domain.
    """

    def __init__(
        self, bridge: Bridge, programs: Programs, far: CallNode, callers: Iterable[CallNode], name: str
    ) -> None:
        self.calls: Counter[str] = Counter()
        self.back: list[float] = []
        self._chance = random.Random(1)
        self._programs, self._far, self._callers = programs, far, tuple(callers)
        self._services = f"{name}_client_dies", f"{name}_server_dies"
        far.serve(*self._services, delay=_DELAY)
        first, second = (called(service, timeout=_TIMEOUT) for service in self._services)
        self._server = bridge.server()
        client_session = bridge.client_session(first)
        bridge.move()
        self._client = bridge.client(second)
        self._sessions = client_session, bridge.server_session()

    @property
    def engines(self) -> tuple[Engine, Engine]:
        """The halves that live on."""
        return self._server, self._client

    def once(self) -> None:
        """Start the halves, and kill them while calls are in flight, of which each caller has had an answer."""
        began = time.monotonic()
        victims = [self._programs.start(session) for session in self._sessions]
        for service in self._services:
            for caller in self._callers:
                eventually(lambda caller=caller, service=service: self._answers(caller, service), what=service)
        self.back.append(time.monotonic() - began)
        for service in self._services:
            for caller in self._callers:
                caller.begin(service, 100_000, at_once=_AT_ONCE)
        until = time.monotonic() + self._chance.uniform(0.0, 0.3)
        eventually(lambda: self._under_way() and time.monotonic() > until)
        for victim in victims:
            victim.kill()
        for service in self._services:
            for caller in self._callers:
                self._note(caller.give_up(service))
        eventually(lambda: not linked(self._server) and not linked(self._client))
        for service, engine in zip(self._services, self.engines, strict=True):
            eventually(lambda engine=engine, service=service: not counts(engine, service).in_flight)
            assert self._far.served(service).again == 0, "a call was sent twice"
            assert self._far.served(service).broken == 0

    def _answers(self, caller: CallNode, service: str) -> bool:
        """Whether a call is answered; one that is not may have gone to a half that is dead."""
        caller.begin(service)
        outcome = caller.settled(service, quiet=0.3)
        if not outcome.answered:
            self._note(caller.give_up(service))
            return False
        self._note(outcome)
        return True

    def _under_way(self) -> bool:
        outcomes = (caller.outcome(service) for caller in self._callers for service in self._services)
        return all(each.answered for each in outcomes) and all(
            counts(engine, name).in_flight for engine, name in zip(self.engines, self._services, strict=True)
        )

    def _note(self, outcome: Outcome) -> None:
        assert not outcome.wrong, outcome.wrong
        self.calls["asked"] += outcome.asked
        self.calls["answered"] += outcome.answered
        self.calls["given up"] += outcome.asked - outcome.answered


def kill(killing: Killing, times: int) -> Tally:
    """Kill both so often; AssertionError where anything is not as it should be."""
    first = min(times - 1, max(2, times // 5))
    with balanced(*killing.engines):
        for _ in range(first):
            killing.once()
        before = resources()
        for _ in range(first, times):
            killing.once()
    nothing_left(*killing.engines)
    returns_to(before)
    gc.collect()
    after = resources()
    return Tally(killing.calls, killing.back, Resources(*(new - old for new, old in zip(after, before, strict=True))))


def main(times: int) -> None:
    """Kill both sides so often, and print what there was."""
    domain_id = two_domains()
    robot, pc = Domain(domain_id), Domain(domain_id + 1)
    far, *callers = CallNode(pc.id), CallNode(robot.id), CallNode(robot.id)
    with tempfile.TemporaryDirectory() as name:
        bridge = Bridge(Path(name), robot, pc)
        programs = Programs(bridge.folder)
        try:
            tally = kill(Killing(bridge, programs, far, callers, "/killing"), times)
        finally:
            bridge.close()
            programs.close()
            for node in (far, *callers):
                node.close()
    back = sorted(tally.back)
    print(f"{times} kills of each side; {dict(tally.calls)}; no wrong answer, none sent twice")  # noqa: T201
    print(f"answered again s after a start: {' '.join(f'{each:.1f}' for each in back)}; {tally.grown}")  # noqa: T201


if __name__ == "__main__":
    main(int(sys.argv[1]))
