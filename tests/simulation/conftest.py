"""Reports the simulated time of a run, its cost, and the numbers of faults, commands and checks."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple, Protocol

import pytest

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from tests.simulation.world import World


class Played(NamedTuple):
    """A world that has been played.

    Attributes:
        simulated: s.
        cpu: s, of this process.
        real: s.
    """

    what: str
    simulated: float
    cpu: float
    real: float
    faults: int
    commands: int
    checks: int

    def __str__(self) -> str:
        return (
            f"{self.simulated / 86_400:8.3f} days in {self.cpu:5.1f} s of CPU time, {self.real:5.1f} s: "
            f"{self.faults:5,} faults, {self.commands:5,} commands, {self.checks:7,} checks  {self.what}"
        )


class Play(Protocol):
    """Plays worlds, and notes what that cost."""

    def __call__(self, world: World, seconds: float, *doings: Coroutine[None, None, None]) -> None:
        """Play a world, as `World.play` does."""
        ...


_PLAYED = pytest.StashKey[list[Played]]()


@pytest.fixture
def play(request: pytest.FixtureRequest) -> Play:
    """Plays a world."""
    played = request.config.stash.setdefault(_PLAYED, [])

    def play(world: World, seconds: float, *doings: Coroutine[None, None, None]) -> None:
        cpu, real = time.process_time(), time.monotonic()
        try:
            world.play(seconds, *doings)
        finally:
            log = world.log
            played.append(
                Played(
                    request.node.name,
                    world.loop.time(),
                    time.process_time() - cpu,
                    time.monotonic() - real,
                    log.faults.total(),
                    log.commands.total(),
                    world.invariants.checks,
                )
            )

    return play


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Report a line for each test function, and the sum of all."""
    played = config.stash.get(_PLAYED, [])
    if not played:
        return
    by_test: dict[str, list[Played]] = {}
    for each in played:
        by_test.setdefault(each.what.partition("[")[0], []).append(each)
    terminalreporter.section("simulated time")
    for what, worlds in (*by_test.items(), ("in all", played)):
        terminalreporter.write_line(str(Played(f"{what}: {len(worlds)}", *_sums(worlds))))


def _sums(worlds: list[Played]) -> tuple[float, float, float, int, int, int]:
    return (
        sum(each.simulated for each in worlds),
        sum(each.cpu for each in worlds),
        sum(each.real for each in worlds),
        sum(each.faults for each in worlds),
        sum(each.commands for each in worlds),
        sum(each.checks for each in worlds),
    )
