"""The figures of a soak as tables, and which bounds are broken."""

from __future__ import annotations

from collections import Counter, defaultdict
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from tests.soak.measures import Life
    from tests.soak.run import Outcome
    from tests.soak.worlds import Worlds

MORE_DESCRIPTORS = 4
MORE_THREADS = 2
"""More than these is growth: name look-ups and the like have threads that begin when they are needed."""
SLOPE_AFTER = 10.0
"""Minutes of a life, after its warm-up, from which on its memory's slope means something."""
GROWTH = 8192.0
"""kB by which the fitted memory may grow in all, and ... The event log fills for hours, and what the allocator keeps
for messages of 500 kB grows less and less with each fault: 5 MB over 220 faults."""
SLOPE = 20.0
"""... kB a minute that it may go on growing by beyond that: a month would be 0.9 GB."""


def broken(outcome: Outcome, recovery: float) -> list[str]:
    """The bounds that do not hold, in words.

    Args:
        recovery: s from the end of a fault until all topics flow.
    """
    reasons = list(outcome.wrong)
    for each in outcome.recoveries:
        if each.seconds is None:
            reasons.append(f"after {each.fault}: not recovered; {each.slowest}")
        elif each.seconds > recovery:
            reasons.append(
                f"after {each.fault}: recovered in {each.seconds:.1f} s (bound {recovery:g}); {each.slowest}"
            )
    for life in outcome.lives:
        for what, more in (("descriptors", MORE_DESCRIPTORS), ("threads", MORE_THREADS)):
            if (grown := life.growth(what)) > more:
                reasons.append(f"{life.program}, process {life.pid}: {grown} more {what} than at the beginning")
        if leaks(life):
            reasons.append(
                f"{life.program}, process {life.pid}: memory grows by {life.slope:.0f} kB/min"
                f" over {life.warm_minutes:.0f} min"
            )
    return reasons


def leaks(life: Life) -> bool:
    """Whether a life is long enough to tell, and its memory grows beyond the bounds."""
    minutes = life.warm_minutes
    return minutes >= SLOPE_AFTER and life.slope * minutes > GROWTH + SLOPE * minutes


def write_samples(lives: Iterable[Life], path: Path) -> None:
    with path.open("w") as file:
        file.write("program,pid,time_s,resident_kb,descriptors,threads\n")
        for life in lives:
            file.writelines(f"{life.program},{life.pid},{','.join(map(str, each))}\n" for each in life.samples)


def of_processes(outcome: Outcome) -> str:
    return "\n\n".join((_lives(outcome.lives), _recoveries(outcome), _ledgers(outcome)))


def of_worlds(worlds: Worlds) -> str:
    return (
        f"simulation: {worlds.days:.1f} simulated days in {worlds.played} worlds"
        f" ({worlds.days_per_hour:.1f} days an hour), {len(worlds.failures)} failed"
    )


def _lives(lives: Sequence[Life]) -> str:
    rows = []
    for program in dict.fromkeys(life.program for life in lives):
        own = [life for life in lives if life.program == program]
        life = max(own, key=lambda each: each.seconds)
        if not life.samples:
            continue
        resident = [each.resident / 1024 for each in life.samples]
        rows.append(
            (
                program,
                str(len(own)),
                f"{life.seconds / 60:.1f}",
                f"{resident[0]:.0f} → {resident[-1]:.0f}, most {max(resident):.0f}",
                f"{life.slope:+.0f} over {life.warm_minutes:.1f}",
                _counts(life, "descriptors"),
                _counts(life, "threads"),
            )
        )
    head = ("process", "lives", "longest, min", "memory there, MB", "kB/min over min", "descriptors", "threads")
    return table(head, rows)


def _counts(life: Life, what: str) -> str:
    counts, calm = (
        [int(getattr(each, what)) for each in samples] for samples in (life.samples, life.calm or life.samples)
    )
    return f"{calm[0]} → {calm[-1]}, most {max(counts)}"


def _recoveries(outcome: Outcome) -> str:
    kinds: dict[str, list[float]] = defaultdict(list)
    never: Counter[str] = Counter()
    for each in outcome.recoveries:
        if each.seconds is None:
            never[each.fault.kind] += 1
        else:
            kinds[each.fault.kind].append(each.seconds)
            kinds["all"].append(each.seconds)
    rows = [
        (kind, str(len(seconds)), f"{median(seconds):.1f}", f"{max(seconds):.1f}", str(never[kind]))
        for kind, seconds in sorted(kinds.items(), key=lambda item: (item[0] == "all", item[0]))
    ]
    rows += [(kind, "0", "", "", str(count)) for kind, count in never.items() if kind not in kinds]
    drawn = (
        f"{outcome.faults} faults, {outcome.faults - len(outcome.recoveries)} of them with the next one close behind"
    )
    return f"{table(('recovery after', 'times', 'median, s', 'worst, s', 'never'), rows)}\n{drawn}"


def _ledgers(outcome: Outcome) -> str:
    rows = [(name, f"{count:,}") for name, count in outcome.ledger.items() if count]
    return (
        f"{table(('messages sent by all processes', 'count'), rows)}\n"
        f"{outcome.checked:,} ledgers were checked; {outcome.heard:,} messages came out at the far ends"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [tuple(head), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )
