"""A run of real processes: faults one after another until time is up, then the audit."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tests.soak.audit import audit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from random import Random

    from tests.soak.faults import Fault
    from tests.soak.measures import Life
    from tests.soak.stage import Stage

_GIVE_UP = 90.0
_SLOW = 5.0
"""s after which the silent topics are printed, with their causes."""
_FIRST_FLOW = 120.0
_CLOSE_BEHIND = 0.2
"""How often the next fault comes without waiting for the recovery from this one."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """After a fault.

    Attributes:
        seconds: from its end until the last topic flowed, or None if that never happened.
        slowest: the last topic, and why it was slow; or what did not flow and why.
    """

    fault: Fault
    seconds: float | None
    slowest: str


@dataclass
class Outcome:
    """All that was found.

    Attributes:
        recoveries: after faults, except those with another fault close behind.
    """

    wrong: list[str] = field(default_factory=list)
    recoveries: list[Recovery] = field(default_factory=list)
    faults: int = 0
    lives: list[Life] = field(default_factory=list)
    ledger: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    heard: int = 0


def play(
    stage: Stage,
    faults: Iterable[Fault],
    random: Random,
    *,
    calm: float = 2.0,
    audited: float,
    tell: Callable[[str], object],
) -> Outcome:
    """Start everything, let the faults happen, and end everything.

    Args:
        stage: which does not run yet.
        random: decides how long it is calm between them.
        calm: s, at least, before each fault, and three times that at most.
        audited: s for which messages are counted at the end.
    """
    outcome = Outcome()
    began = time.monotonic()
    try:
        stage.expect()
        stage.start()
        if not stage.live_until(lambda: stage.flows, _FIRST_FLOW):
            outcome.wrong.append(f"nothing flows {_FIRST_FLOW:g} s after the start: {stage.missing()}")
            return outcome
        tell(f"{time.monotonic() - began:7.1f} s  all topics flow")
        close_behind = False
        for fault in faults:
            if close_behind:
                stage.live(random.uniform(0.0, calm))
            else:
                stage.live(random.uniform(calm, 3 * calm))
                stage.calm()
            outcome.faults += 1
            fault.strike(stage)
            if close_behind := random.random() < _CLOSE_BEHIND:
                tell(f"{time.monotonic() - began:7.1f} s  {fault}: the next one is close behind")
                continue
            outcome.recoveries.append(recovery := _recover(stage, fault))
            took = "NOT RECOVERED" if recovery.seconds is None else f"{recovery.seconds:.1f} s"
            tell(f"{time.monotonic() - began:7.1f} s  {fault}: {took} ({recovery.slowest})")
            if recovery.seconds is None:
                return outcome
        stage.expect()
        if stage.live_until(lambda: stage.flows, _GIVE_UP):
            outcome.wrong += audit(stage, audited)
        else:
            outcome.wrong.append(f"not recovered before the audit: {stage.missing()}")
        stage.stop()
    finally:
        _gather(stage, outcome)
    return outcome


def _recover(stage: Stage, fault: Fault) -> Recovery:
    ended = stage.expect()
    late = "" if stage.live_until(lambda: stage.flows, _SLOW) else f"; {_SLOW:g} s after the fault: {stage.missing()}"
    if late and not stage.live_until(lambda: stage.flows, _GIVE_UP - _SLOW):
        return Recovery(fault, None, stage.missing())
    last = max(stage.listeners, key=lambda listener: listener.flowed_at or 0.0)
    return Recovery(fault, (last.flowed_at or ended) - ended, last.name + late)


def _gather(stage: Stage, outcome: Outcome) -> None:
    for program in stage.programs:
        outcome.lives += program.lives
        outcome.wrong += program.wrong
        for book in program.books:
            outcome.wrong += book.wrong
            outcome.checked += book.checked
            outcome.ledger.update(book.totals())
    for listener in stage.listeners:
        outcome.heard += listener.heard
        outcome.wrong += listener.wrong
