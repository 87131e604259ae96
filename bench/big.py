"""Big messages, by TCP and through a relay, in turns: ``python -m bench.big [ROUNDS]``.

Prints the medians of CPU and page faults a message between talker and listener, and the share of messages received.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from bench import bed

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

_CASES = ((100_000, 1_000), (100_000, 3_000), (1_000_000, 100), (1_000_000, 250), (6_000_000, 30))
"""Bytes and Hz."""
_BEDS: dict[str, Callable[[], AbstractContextManager[bed.Bed]]] = {
    "relay": bed.relayed,
    "tcp": lambda: bed.bridged("tcp"),
    "udp": lambda: bed.bridged("udp"),
}
_SECONDS = 2.0


class _Figures(NamedTuple):
    """µs of CPU and page faults a message, and the part of the messages that came."""

    cpu: float
    faults: float
    delivered: float


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    found: defaultdict[tuple[str, int, int], list[_Figures]] = defaultdict(list)
    for _ in range(rounds):
        for kind, make in _BEDS.items():
            with make() as between:
                for size, rate in _CASES:
                    between.send(rate, 0.3, size)  # memory that a first message needs is no message's
                    found[kind, size, rate].append(_measure(between, size, rate))
    print(f"{'bytes':>9} {'Hz':>6} {'':>6} {'CPU, µs':>9} {'of relay':>9} {'faults':>7} {'came':>6}")
    for size, rate in _CASES:
        floor = median(each.cpu for each in found["relay", size, rate])
        for kind in _BEDS:
            cpu, faults, delivered = (median(each) for each in zip(*found[kind, size, rate], strict=True))
            print(f"{size:>9,} {rate:>6,} {kind:>6} {cpu:>9.0f} {cpu / floor:>9.2f} {faults:>7.0f} {delivered:>6.2f}")


def _measure(between: bed.Bed, size: int, rate: int) -> _Figures:
    before = _faults(between)
    run = between.send(rate, _SECONDS, size)
    return _Figures(run.cpu_per_message, (_faults(between) - before) / run.sent, run.received / run.sent)


def _faults(between: bed.Bed) -> int:
    """Page faults so far (proc(5), minflt)."""
    stats = [Path(f"/proc/{process.pid}/stat").read_text() for process in between.between]
    return sum(int(stat.rsplit(")", 1)[1].split()[7]) for stat in stats)


if __name__ == "__main__":
    main()
