"""The sizes of a world, and the rates of its messages, faults and commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True)
class Conditions:
    """The ranges from which a world's contents are drawn.

    Attributes:
        periods: s, between which the average time from one message of a topic to the next is.
        size: bytes of a message, at most, on average.
        faults: s from one fault of a robot to the next, on average, or 0 for no faults. Its topics have as many, and
            the server a fifth.
        commands: s from one command of an operator to the next, on average, or 0 for no commands.
        nights: part of the time that each robot is switched off, for hours: an engine that waits alone costs a tenth of
            one that is linked, so more days with faults can be lived in the same time.
        outlive: s that links outlive their connections.
        moves: s from one fault of a robot's connections alone to the next, on average, or 0 for none.
        keep: s of which topics over streams keep all messages, or 0 for what QoS keeps.
        patience: how many times longer than usual everything may take: more where an engine is slowed down.
    """

    name: str
    robots: Sequence[int] = (1,)
    topics: Sequence[int] = (1, 2, 3)
    services: Sequence[int] = (0, 1)
    actions: Sequence[int] = (0,)
    periods: tuple[float, float] = (2.0, 60.0)
    latched: float = 0.2
    size: int = 400
    faults: float = 120.0
    commands: float = 300.0
    nights: float = 0.6
    checks: tuple[float, float] = (1.0, 5.0)
    outlive: float = 0.0
    moves: float = 0.0
    keep: float = 0.0
    patience: float = 1.0


QUIET = Conditions("quiet", topics=(1, 1, 2), periods=(10.0, 300.0), faults=400.0, commands=900.0)
"""A robot that is used by day, where something happens a few times an hour."""
LIVELY = Conditions("lively", robots=(1, 1, 2))
"""A robot or two, where something happens every minute."""
STORM = Conditions(
    "storm", robots=(1, 1, 2), services=(1, 2), periods=(0.2, 20.0), size=20_000, faults=15.0, commands=30.0
)
"""Where something happens every few seconds."""
FLEET = Conditions("fleet", robots=(5, 6, 7, 8), topics=(1, 2, 3, 4), periods=(1.0, 60.0), faults=180.0, commands=300.0)
"""Many robots on one server."""
STILL = Conditions(
    "still",
    topics=(1,),
    services=(0,),
    periods=(600.0, 600.0),
    faults=0.0,
    commands=0.0,
    nights=0.0,
    latched=0.0,
    checks=(60.0, 60.0),
)
"""Without faults and commands; a test causes all that happens."""

CALLS = Conditions("calls", robots=(1, 2), topics=(1,), services=(2, 3), periods=(0.5, 10.0), faults=30.0, nights=0.2)
"""Where services are called all the time."""

ACTIONS = Conditions(
    "actions", topics=(1,), services=(0,), actions=(1, 2), periods=(10.0, 60.0), faults=60.0, commands=0.0, nights=0.0
)
"""Where goals are sent all the time, and nobody at a console changes anything."""
KEEPING = Conditions(
    "keeping",
    topics=(2, 3),
    services=(0,),
    periods=(0.2, 1.0),
    faults=60.0,
    commands=0.0,
    nights=0.0,
    latched=0.0,
    outlive=300.0,
    keep=120.0,
)
"""Where topics keep all messages of two minutes for their links, which are away for as long."""
_WITH_ACTIONS = 0.15


def draw_conditions(random: Random) -> Conditions:
    conditions = random.choices((QUIET, LIVELY, STORM, FLEET), (4, 4, 2, 1))[0]
    return ACTIONS if random.random() < _WITH_ACTIONS else conditions
