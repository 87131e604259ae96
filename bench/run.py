"""Prints the bridge's figures next to the figures of no bridge, a relay, and the thesis's pipeline: ``make bench``.

Each round measures all of them in turn, so that other load on the machine affects all equally. Figures are medians of
the rounds with the lowest and the highest; ratios are of one round each. Machines differ; the ratios hold.
"""

from __future__ import annotations

import math
import os
import platform
import statistics
import sys
import time
from collections import defaultdict
from typing import TYPE_CHECKING

from bench import bed, calls, opening
from rsb_console.bench.suite import highest_lossless

if TYPE_CHECKING:
    from rsb_console.bench.results import Run

SIZES = (2_500, 5_000, 10_000)
CPU_RATES = (100, 1_000, 5_000, 10_000, 20_000, 30_000)
LARGE = ((100_000, 1_000), (100_000, 3_000), (1_000_000, 100), (1_000_000, 250), (6_000_000, 30))
"""Bytes, and Hz at which their CPU is measured."""
FIRST_RATE = 5_000
SECONDS, LATENCY_SECONDS, IDLE_SECONDS = 2.0, 10.0, 5.0
ROUNDS = 3

# Between talker and listener. "rclpy" and "drained" have no bridge: a raw subscription on rclpy's executor,
# and one on a drain loop like the bridge's own.
BEDS = {
    "rclpy": lambda: bed.direct("spin"),
    "drained": bed.direct,
    "relay": bed.relayed,
    "tcp": lambda: bed.bridged("tcp"),
    "udp": lambda: bed.bridged("udp"),
    "thesis": bed.thesis,
}
NONE = ("rclpy", "drained")
_FEW = 0.99  # of the messages that have to arrive for a figure of the CPU to count
_Figures = defaultdict[tuple[str, str], list[float]]


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    cores, load = os.cpu_count(), os.getloadavg()[0]
    print(f"{platform.machine()}, {cores} cores, Python {platform.python_version()}, load {load:.1f}, {rounds} rounds")
    figures: _Figures = defaultdict(list)
    for _ in range(rounds):
        for kind, make in BEDS.items():
            with make() as between:
                _measure(kind, between, figures)
    rates = [f"{size:,} B" for size in SIZES]
    _print(figures, "Highest lossless rate, msg/s", rates, ("drained", "relay", "thesis"), 0)
    at = [f"{rate:,} Hz" for rate in CPU_RATES] + [f"{size:,} B at {rate:,} Hz" for size, rate in LARGE]
    _print(
        figures,
        "CPU of all between, µs a message (2,500 B unless said; nan: more than 1 % lost)",
        at,
        ("relay", "thesis"),
        0,
    )
    _print(figures, "Share of these received, %", [f"{each} came" for each in at], (), 1)
    _print(figures, "Latency at 100 Hz, 2,500 B, ms", ["p50", "p99", "p99.9"], ("drained", "relay"), 2)
    _print(figures, "Memory, MB a side; idle, % of a core a side", ["memory", "idle"], (), 2)
    opening.report(opening.TOPICS)
    calls.report(calls.ROUNDS)


def _measure(kind: str, between: bed.Bed, figures: _Figures) -> None:
    gentle = between.send(100, LATENCY_SECONDS, SIZES[0])
    for name, value in (("p50", gentle.p50), ("p99", gentle.p99), ("p99.9", gentle.p999)):
        figures[kind, name].append(value)
    for size in SIZES:

        def trial(rate: float, size: int = size) -> Run:
            return between.send(rate, SECONDS, size)

        best = highest_lossless(trial, first=FIRST_RATE).best
        figures[kind, f"{size:,} B"].append(best.rate if best else math.nan)
    if kind in NONE:
        return
    figures[kind, "memory"].append(max(process.memory() for process in between.between))
    figures[kind, "idle"].append(_idle(between))
    wanted = [(f"{rate:,} Hz", SIZES[0], rate) for rate in CPU_RATES]
    wanted += [(f"{size:,} B at {rate:,} Hz", size, rate) for size, rate in LARGE]
    for name, size, rate in wanted:
        if kind == "thesis" and size > SIZES[-1]:  # it searches all that it has for each 1,024 bytes: minutes for 6 MB
            figures[kind, name].append(math.nan)
            figures[kind, f"{name} came"].append(math.nan)
            continue
        run = between.send(rate, SECONDS, size)
        kept = run.received >= _FEW * run.sent and run.rate > 0.95 * rate
        figures[kind, name].append(run.cpu_per_message if kept else math.nan)
        figures[kind, f"{name} came"].append(100 * run.received / run.sent)


def _idle(between: bed.Bed) -> float:
    before, began = sum(process.cpu() for process in between.between), time.monotonic()
    time.sleep(IDLE_SECONDS)
    used = sum(process.cpu() for process in between.between) - before
    return used / (time.monotonic() - began) / len(between.between) * 100


def _print(figures: _Figures, title: str, names: list[str], others: tuple[str, ...], digits: int) -> None:
    """Print one table: a row for each figure with a column for each kind, and the ratios of ours to others."""
    kinds = [kind for kind in BEDS if figures.get((kind, names[0]))]
    pairs = [(ours, other) for ours in ("tcp", "udp") for other in others]
    print(f"\n{title}: median (lowest to highest)")
    print(f"{'':>22}", *(f"{kind:>22}" for kind in kinds), *(f"{'/'.join(pair):>12}" for pair in pairs))
    for name in names:
        cells = [_spread(figures[kind, name], digits) for kind in kinds]
        ratios = [
            statistics.median(
                a / b if b else math.nan for a, b in zip(figures[ours, name], figures[other, name], strict=True)
            )
            for ours, other in pairs
        ]
        print(f"{name:>22}", *(f"{cell:>22}" for cell in cells), *(f"{ratio:>12.2f}" for ratio in ratios), flush=True)


def _spread(values: list[float], digits: int) -> str:
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:,.{digits}f} ({low:,.{digits}f} to {high:,.{digits}f})"


if __name__ == "__main__":
    main()
