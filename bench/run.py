"""Prints the bridge's figures next to no bridge, a relay, and the thesis's pipeline: ``make bench``.

``python -m bench.run [ROUNDS] [--beds relay,tcp] [--only small|large|rates|calls]``. All beds run at once, each in a
pair of ROS domains of its own, and take turns in bursts of one or two seconds. What else the machine does meets all
of them, so the ratios hold where the figures don't. Figures are medians of the rounds with the lowest and the highest;
ratios and differences are of bursts of the same round.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed, calls
from bench.figures import Figures, in_turn, print_table

from rsb_extras.bench.suite import highest_lossless

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from rsb_extras.bench.results import Run

ROUNDS = 3
DEFAULT_BEDS = ("drained", "relay", "bare-tcp", "tcp", "udp", "zenoh", "thesis")
PARTS = ("small", "large", "rates", "calls")
RATE_SIZES = (2_500, 10_000)
DOMAINS = range(66, 92, 2)
"""The first domain of each bed's pair: below 102, where the kernel's ports begin. Tests have those up to 80, too."""
LARGEST = {"thesis": 10_000}
"""Most bytes of a message. The thesis's pipeline searches all that it has for each KiB, minutes for 6 MB."""
WARM_SECONDS, IDLE_SECONDS, RATE_SECONDS = 0.2, 5.0, 0.5
FIRST_RATE, CLOSE = 10_000.0, 1.25  # highest rates are searched to a quarter (bench/README.md, Method)
FEW, KEPT_UP = 0.99, 0.9
"""Shares of the messages that have to arrive, and of the rate that the talker has to reach, for a burst to count."""


class Load(NamedTuple):
    """Messages of one burst."""

    rate: int
    size: int
    seconds: float = 1.0

    def __str__(self) -> str:
        return f"{self.size:,} B at {self.rate:,} Hz"


SMALL = (Load(100, 2_500, 2.0), *(Load(rate, 2_500) for rate in (1_000, 5_000, 10_000, 20_000)))
LARGE = (Load(1_000, 100_000), Load(3_000, 100_000), Load(100, 1_000_000), Load(250, 1_000_000), Load(30, 6_000_000))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.run")
    parser.add_argument("rounds", nargs="?", type=int, default=ROUNDS)
    parser.add_argument("--beds", default=",".join(DEFAULT_BEDS), help=f"of {', '.join(bed.BEDS)}")
    parser.add_argument("--only", choices=PARTS)
    options = parser.parse_args()
    kinds = options.beds.split(",")
    if unknown := set(kinds) - bed.BEDS.keys():
        parser.error(f"no such bed: {', '.join(sorted(unknown))}")
    parts = (options.only,) if options.only else PARTS
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}, load {os.getloadavg()[0]:.1f}, {options.rounds} rounds", flush=True)
    figures, began = Figures(), time.monotonic()
    if parts != ("calls",):
        _run_topics(figures, kinds, parts, options.rounds)
    if "calls" in parts:
        # No bed has the last pair, since there are fewer beds than pairs.
        calls.run(figures, options.rounds, DOMAINS[-1])
    print(f"\nload {os.getloadavg()[0]:.1f}, {(time.monotonic() - began) / 60:.1f} min")


def _run_topics(figures: Figures, kinds: Sequence[str], parts: Sequence[str], rounds: int) -> None:
    loads = [*(SMALL if "small" in parts else ()), *(LARGE if "large" in parts else ())]
    full = _full_buffers()
    with _standing(kinds) as beds:
        _measure_idle(figures, beds)
        for number in range(rounds):
            for turn, load in enumerate(loads):
                for kind in in_turn(kinds, number + turn):
                    if load.size <= LARGEST.get(kind, load.size):
                        _measure(figures, number, kind, beds[kind], load)
            for turn, size in enumerate(RATE_SIZES if "rates" in parts else ()):
                for kind in in_turn(kinds, number + turn):
                    _search(figures, number, kind, beds[kind], size)
        for kind, each in beds.items():
            for number, process in enumerate(each.between):
                figures.add(number, kind, "memory", process.memory())
    _print(figures, kinds, loads)
    print(f"\nUDP datagrams without room in a receive buffer, of all programs: {_full_buffers() - full:,}")


@contextlib.contextmanager
def _standing(kinds: Sequence[str]) -> Iterator[dict[str, bed.Bed]]:
    with contextlib.ExitStack() as resources:
        yield {
            kind: resources.enter_context(bed.BEDS[kind](near, near + 1))
            for kind, near in zip(kinds, DOMAINS, strict=False)
        }


def _measure_idle(figures: Figures, beds: Mapping[str, bed.Bed]) -> None:
    """Measure all beds at once while nothing crosses: each side, and the sum that disturbs a measured bed."""
    sides = {(kind, at): process for kind, each in beds.items() for at, process in enumerate(each.between)}
    ends = [process for each in beds.values() for process in (each.talker, each.listener)]
    before, began = {key: process.cpu() for key, process in sides.items()}, time.monotonic()
    ends_before = sum(process.cpu() for process in ends)
    time.sleep(IDLE_SECONDS)
    percent = 100 / (time.monotonic() - began)
    for (kind, at), process in sides.items():
        figures.add(at, kind, "idle", (process.cpu() - before[kind, at]) * percent)
    total = sum(process.cpu() for process in sides.values()) - sum(before.values())
    total += sum(process.cpu() for process in ends) - ends_before
    print(f"all {len(beds)} beds while idle: {total * percent:.1f} % of a core", flush=True)


def _measure(figures: Figures, number: int, kind: str, between: bed.Bed, load: Load) -> None:
    between.send(load.rate, WARM_SECONDS, load.size)  # the beds before it have emptied the caches
    faults = _page_faults(between)
    run = between.send(load.rate, load.seconds, load.size)
    figures.add(number, kind, f"{load} came", 100 * run.received / run.sent)
    if run.received < FEW * run.sent or run.rate < KEPT_UP * load.rate:
        return
    figures.add(number, kind, f"{load} p50", run.p50)
    figures.add(number, kind, f"{load} p99", run.p99)
    if between.between:
        figures.add(number, kind, f"{load} CPU", sum(run.sides) / run.sent * 1e6)  # µs
        figures.add(number, kind, f"{load} faults", (_page_faults(between) - faults) / run.sent)


def _search(figures: Figures, number: int, kind: str, between: bed.Bed, size: int) -> None:
    """Find the highest lossless rate, from the last round's on."""

    def trial(rate: float) -> Run:
        return between.send(rate, RATE_SECONDS, size)

    quantity = f"{size:,} B"
    best = highest_lossless(trial, first=figures.latest(kind, quantity) or FIRST_RATE, close=CLOSE).best
    if best is not None:
        figures.add(number, kind, quantity, best.rate)


def _page_faults(between: bed.Bed) -> int:
    """Page faults so far (proc(5), minflt)."""
    stats = [Path(f"/proc/{process.pid}/stat").read_text() for process in between.between]
    return sum(int(stat.rsplit(")", 1)[1].split()[7]) for stat in stats)


def _full_buffers() -> int:
    """Count the datagrams that the kernel dropped because a receive buffer was full, for all IPv4 sockets."""
    names, values = (
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    )
    return int(values[names.index("RcvbufErrors")])


def _print(figures: Figures, kinds: Sequence[str], loads: Sequence[Load]) -> None:
    """Print all tables: a row for each load or quantity, a column for each bed."""
    rows, large = [str(load) for load in loads], [str(load) for load in loads if load in LARGE]
    between = [kind for kind in kinds if kind != "drained"]
    rates = [f"{size:,} B" for size in RATE_SIZES]

    def print_ratios(what: str, which: Sequence[str], of: str = "") -> None:
        for other in ("relay", "thesis"):
            columns = [kind for kind in between if kind in bed.OURS or (kind, other) == ("thesis", "relay")]
            print_table(f"{what}, in ratio to {other}", which, columns, partial(figures.ratio, other=other), 2, of)

    print_table("CPU of all between talker and listener, µs a message", rows, between, figures.spread, 0, "CPU")
    print_ratios("CPU", rows, "CPU")
    added = partial(figures.added, other="drained")
    for quantile in ("p50", "p99"):
        print_table(f"Latency, {quantile}, ms", rows, kinds, figures.spread, 2, quantile)
        print_table(f"Added latency, {quantile}, ms beyond drained", rows, between, added, 2, quantile)
    print_table("Share received, %", rows, kinds, figures.spread, 1, "came")
    print_table("Page faults a message", large, between, figures.spread, 1, "faults")
    print_table("Highest lossless rate, msg/s", rates, kinds, figures.spread, 0)
    print_ratios("Highest lossless rate", rates)
    print_table("Each side: memory, MB; idle, % of a core", ["memory", "idle"], between, figures.spread, 2)


if __name__ == "__main__":
    main()
