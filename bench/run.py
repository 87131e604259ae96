"""Prints the bridge's figures next to those of no bridge and of the thesis's pipeline, in one run: ``make bench``.

Machines differ and are noisy; the ratios of one run hold.
"""

from __future__ import annotations

import os
import platform
import time

import bed

SIZES = (2_500, 5_000, 10_000)
FIRST_RATE = 5_000
SECONDS = 2.0


def main() -> None:
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    beds = {
        "none": bed.direct,
        "tcp": lambda: bed.bridged("tcp"),
        "udp": lambda: bed.bridged("udp"),
        "thesis": bed.thesis,
    }
    lossless: dict[tuple[str, int], float] = {}
    cpu: dict[tuple[str, int], float] = {}
    for kind, make in beds.items():
        with make() as between:
            for size in SIZES:
                lossless[kind, size] = _lossless(between, size)
            if between.between:
                for rate in (1_000, 10_000, 30_000):
                    cpu[kind, rate] = _cpu(between, rate)
    print("highest lossless rate, msg/s (2 s each)")
    columns = ("rclpy", "drained", "TCP", "UDP", "thesis", "TCP/rclpy", "UDP/rclpy", "TCP/thesis", "UDP/thesis")
    print(
        "rclpy: no bridge, a raw subscription on rclpy's executor; drained: no bridge, on a drain loop like the bridge's"
    )
    print(f"{'size':>8} " + " ".join(f"{column:>10}" for column in columns))
    for size in SIZES:
        spin, none, tcp, udp, old = (lossless[kind, size] for kind in beds)
        rates = " ".join(f"{rate:>10.0f}" for rate in (spin, none, tcp, udp, old))
        ratios = " ".join(f"{ratio:>10.2f}" for ratio in (tcp / spin, udp / spin, tcp / old, udp / old))
        print(f"{size:>8} {rates} {ratios}")
    print("\nCPU of both sides together, µs a message of 2,500 bytes (nan: not without loss)")
    print(f"{'rate':>8} {'TCP':>8} {'UDP':>8} {'thesis':>8} {'TCP/thesis':>11}")
    for rate in (1_000, 10_000, 30_000):
        tcp, udp, old = (cpu[kind, rate] for kind in ("tcp", "udp", "thesis"))
        print(f"{rate:>8} {tcp:>8.1f} {udp:>8.1f} {old:>8.1f} {tcp / old:>11.2f}")
    print("\nlatency at 100 Hz, 2,500 bytes, ms; memory; idle")
    del beds["spin"]
    for kind, make in beds.items():
        with make() as between:
            run = between.send(100, 15.0, 2_500)
            line = f"{kind:>8} p50 {run.p50:.2f} p99 {run.p99:.2f}"
            if kind == "none":
                base = run
            else:
                line += f"  added p50 {run.p50 - base.p50:.2f} p99 {run.p99 - base.p99:.2f}"
                line += f"  memory {' + '.join(f'{p.memory():.0f}' for p in between.between)} MB"
                line += f"  idle {_idle(between):.2f} % CPU a side"
            print(line)


def _lossless(between: bed.Bed, size: int) -> float:
    """The highest rate (Hz) at which nothing was lost, to a tenth; each rate has two tries."""
    rate, good, bad = FIRST_RATE, 0.0, 0.0
    while not bad or bad > 1.1 * good:
        runs = (between.send(int(rate), SECONDS, size) for _ in range(2))
        passed = next((run for run in runs if run.received >= run.sent), None)
        if passed is None:
            bad = rate
        elif passed.rate < 0.95 * rate:
            return passed.rate  # the talker can't do more
        else:
            good = passed.rate
        rate = (good + bad) / 2 if good and bad else rate * 2 if good else rate / 2
    return good


def _cpu(between: bed.Bed, rate: int) -> float:
    run = between.send(rate, 3.0, 2_500)
    return run.cpu_per_message if run.received >= run.sent and run.rate > 0.95 * rate else float("nan")


def _idle(between: bed.Bed) -> float:
    before, began = sum(process.cpu() for process in between.between), time.monotonic()
    time.sleep(10)
    used = sum(process.cpu() for process in between.between) - before
    return used / (time.monotonic() - began) / len(between.between) * 100


if __name__ == "__main__":
    main()
