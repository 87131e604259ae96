"""Faults of a stage, one after another; a seed decides whose turn it is, and for how long."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from tests.soak.network import Condition
    from tests.soak.processes import Process
    from tests.soak.stage import Stage

_KILLS_UNTIL = 1 / 3
"""The server and the first client are killed in this part of the run only, so that a long life of both is measured."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong, and is put right after a while.

    Attributes:
        kind: of `ACTS`.
        place: 0: the server, or the PC; else the client's number.
    """

    kind: str
    place: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.kind}, {f'robot{self.place}' if self.place else 'server'}, {self.seconds:.1f} s"

    def strike(self, stage: Stage) -> None:
        ACTS[self.kind](stage, self.place, self.seconds)


def _gone(stage: Stage, process: Process, seconds: float) -> None:
    process.kill()
    stage.live(seconds)
    stage.restart(process)


def _killed(stage: Stage, place: int, seconds: float) -> None:
    _gone(stage, stage.programs[place], seconds)


def _talkers_killed(stage: Stage, place: int, seconds: float) -> None:
    _gone(stage, stage.talkers[place], seconds)


def _frozen(stage: Stage, place: int, seconds: float) -> None:
    stage.programs[place].freeze()
    stage.live(seconds)
    stage.programs[place].thaw()


def _network(condition: Condition) -> Callable[[Stage, int, float], None]:
    def strike(stage: Stage, place: int, seconds: float) -> None:
        path = stage.network[place - 1]
        path.become(condition)
        stage.live(seconds)
        path.become("whole")

    return strike


def _flapping(stage: Stage, place: int, seconds: float) -> None:
    """Cut and whole in turns, a second and a half each."""
    path = stage.network[place - 1]
    for _ in range(max(1, round(seconds / 3))):
        path.become("cut")
        stage.live(1.5)
        path.become("whole")
        stage.live(1.5)


ACTS: dict[str, Callable[[Stage, int, float], None]] = {
    "kill -9": _killed,
    "talkers killed": _talkers_killed,
    "frozen": _frozen,
    "cut": _network("cut"),
    "stalled": _network("stalled"),
    "refused": _network("refusing"),
    "flapping": _flapping,
}
_ON_THE_NETWORK = {"cut", "stalled", "refused", "flapping"}
_LONGEST = {"kill -9": 5.0, "talkers killed": 5.0}


def draw(random: Random, clients: int, share: float) -> Fault:
    """The next fault.

    Args:
        share: of the run that is over, 0 to 1.
    """
    kind = random.choices(tuple(ACTS), (4, 2, 2, 4, 1, 2, 1))[0]
    places = range(1, clients + 1) if kind in _ON_THE_NETWORK else range(clients + 1)
    if kind == "kill -9" and share > _KILLS_UNTIL and clients > 1:
        places = range(2, clients + 1)
    longest = _LONGEST.get(kind, 20.0)
    return Fault(
        kind, random.choice(places), min(longest, random.choice((random.uniform(0.1, 3.0), random.uniform(1.0, 20.0))))
    )
