"""Prints the bridge's figures next to those of no bridge and of the thesis's pipeline, in one run: ``make bench``.

Machines differ and are noisy; the ratios of one run hold.
"""

from __future__ import annotations

import math
import os
import platform
import time

from bench import bed, calls, opening

SIZES = (2_500, 5_000, 10_000)
CPU_RATES = (1_000, 10_000, 30_000)
FIRST_RATE = 5_000
SECONDS = 2.0

# What stands between talker and listener. "rclpy" and "drained" are no bridge: a raw subscription on rclpy's executor,
# and one on a drain loop like the bridge's own.
BEDS = {
    "rclpy": lambda: bed.direct("spin"),
    "drained": bed.direct,
    "tcp": lambda: bed.bridged("tcp"),
    "udp": lambda: bed.bridged("udp"),
    "thesis": bed.thesis,
}
BRIDGES = ("tcp", "udp", "thesis")


def main() -> None:
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    rates: dict[tuple[str, int], bed.Run] = {}
    cpu: dict[tuple[str, int], float] = {}
    for kind, make in BEDS.items():
        with make() as between:
            for size in SIZES:
                rates[kind, size] = _highest(between, size)
            for rate in CPU_RATES if kind in BRIDGES else ():
                cpu[kind, rate] = _cpu(between, rate)
    _print_rates(rates)
    _print_cpu(rates, cpu)
    _print_latency()
    opening.report(opening.TOPICS)
    calls.report(calls.ROUNDS)


def _print_rates(rates: dict[tuple[str, int], bed.Run]) -> None:
    print("Highest lossless rate, msg/s")
    ratios = (("tcp", "rclpy"), ("udp", "rclpy"), ("tcp", "thesis"), ("udp", "thesis"))
    _row("bytes", *BEDS, *("/".join(pair) for pair in ratios))
    for size in SIZES:
        reached = {kind: rates[kind, size].rate for kind in BEDS}
        _row(
            size, *(f"{rate:.0f}" for rate in reached.values()), *(f"{reached[a] / reached[b]:.2f}" for a, b in ratios)
        )


def _print_cpu(rates: dict[tuple[str, int], bed.Run], cpu: dict[tuple[str, int], float]) -> None:
    print("\nCPU of both sides together, µs a message of 2,500 bytes (nan: not without loss)")
    _row("rate", *BRIDGES, "tcp/thesis", "udp/thesis")
    for rate in CPU_RATES:
        _cpu_row(rate, [cpu[kind, rate] for kind in BRIDGES])
    _cpu_row("highest", [rates[kind, SIZES[0]].cpu_per_message for kind in BRIDGES])


def _cpu_row(rate: object, costs: list[float]) -> None:
    tcp, udp, thesis = costs
    _row(rate, *(f"{cost:.1f}" for cost in costs), f"{tcp / thesis:.2f}", f"{udp / thesis:.2f}")


def _print_latency() -> None:
    print("\nLatency at 100 Hz, 2,500 bytes, ms; memory, MB a side; idle, % CPU a side")
    _row("", "p50", "p99", "added p50", "added p99", "memory", "idle")
    with BEDS["drained"]() as between:
        base = between.send(100, 20.0, SIZES[0])
        _row("drained", f"{base.p50:.2f}", f"{base.p99:.2f}")
    for kind in BRIDGES:
        with BEDS[kind]() as between:
            run = between.send(100, 20.0, SIZES[0])
            added = f"{run.p50 - base.p50:.2f}", f"{run.p99 - base.p99:.2f}"
            memory = max(process.memory() for process in between.between)
            _row(kind, f"{run.p50:.2f}", f"{run.p99:.2f}", *added, f"{memory:.0f}", f"{_idle(between):.2f}")


def _row(*cells: object) -> None:
    print(" ".join(f"{cell!s:>11}" for cell in cells))


def _highest(between: bed.Bed, size: int) -> bed.Run:
    """The run at the highest rate at which nothing was lost, to a tenth; each rate has two tries."""
    rate, good, bad = float(FIRST_RATE), None, 0.0
    while not (good and bad) or bad > 1.1 * good.rate:
        tries = (between.send(int(rate), SECONDS, size) for _ in range(2))
        passed = next((run for run in tries if run.lossless), None)
        if passed is None:
            bad = rate
        else:
            good = passed
            if passed.rate < 0.95 * rate:
                return passed  # the talker can't do more
        rate = (good.rate + bad) / 2 if good and bad else rate * 2 if good else rate / 2
    return good


def _cpu(between: bed.Bed, rate: int) -> float:
    run = between.send(rate, 3.0, SIZES[0])
    return run.cpu_per_message if run.lossless and run.rate > 0.95 * rate else math.nan


def _idle(between: bed.Bed) -> float:
    before, began = sum(process.cpu() for process in between.between), time.monotonic()
    time.sleep(10)
    used = sum(process.cpu() for process in between.between) - before
    return used / (time.monotonic() - began) / len(between.between) * 100


if __name__ == "__main__":
    main()
