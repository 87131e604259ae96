"""Prints the cost of the console: alone with five hundred topics, and next to a bridge that carries 5,000 msg/s."""

from __future__ import annotations

import statistics
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING

from bench import bed
from tests.console.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

RATE, SIZE, SECONDS, ROUNDS = 5_000, 2_500, 10.0, 5
OVER_SSH = {"SSH_CONNECTION": "bench"}  # the refresh is 2 Hz then
KEYS = 30


class Watched(bed.Process):
    """A Python program in a pseudo-terminal whose reader is as fast as a terminal."""

    def __init__(self, *command: str, environ: Mapping[str, str]) -> None:
        self.terminal = Terminal(sys.executable, *command, environ={"COLORTERM": "", **environ})
        self._stopping = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        while not self._stopping.is_set():
            self.terminal.read(0.05)

    @property
    def written(self) -> int:
        return len(self.terminal.output)

    @property
    def pid(self) -> int:
        return self.terminal.pid

    def until(self, condition: Callable[[], bool], seconds: float = 20.0) -> float:
        """Wait; how long it took, s."""
        began = time.perf_counter()
        while not condition():
            if time.perf_counter() - began > seconds:
                raise SystemExit(f"the console does not answer: {self.terminal.output[-300:]!r}")
            time.sleep(0.001)
        return time.perf_counter() - began

    def stop(self) -> None:
        self._stopping.set()
        self._reader.join()
        self.terminal.__exit__()


def main() -> None:
    print("500 topics, each figure changing in a third of the refreshes, 120x36")
    print(f"{'refresh':>8} {'first paint':>12} {'CPU of a core':>14} {'sent':>10} {'key p50':>8} {'key worst':>10}")
    for rate, environ in (("4 Hz", {}), ("2 Hz", OVER_SSH)):
        _alone(rate, environ)
    print("the same, 100 of the rows services and 20 actions with goals")
    for rate, environ in (("4 Hz", {}), ("2 Hz", OVER_SSH)):
        _alone(rate, environ, "calls")
    print("the fleet's screen, 200 robots, half of them changing in each refresh, at 2 Hz, as the console over SSH")
    _alone("2 Hz", OVER_SSH, program=("bench.fleet_alone", "200"), landmark=b"Robots")
    print(f"\na bridge carrying {RATE} msg/s of {SIZE} bytes over TCP, {ROUNDS} x {SECONDS:.0f} s each, by turns")
    print(f"{'client':>8} {'lost':>6} {'p50 ms':>8} {'p99 ms':>8} {'of which':>12} {'CPU s':>7} {'p99 ratio':>10}")
    over_ssh = partial(_console, environ=OVER_SSH)
    clients = {"no-ui": None, "4 Hz": _console, "2 Hz": over_ssh, "no-ui 2": None}  # the last shows the noise
    runs = [[_carried(client) for client in clients.values()] for _ in range(ROUNDS)]
    by_client = [_medians(rounds) for rounds in zip(*runs, strict=True)]
    for index, (name, (lost, p50, p99, cpu)) in enumerate(zip(clients, by_client, strict=True)):
        each = sorted(rounds[index][2] for rounds in runs)
        print(
            f"{name:>8} {lost:>6.0f} {p50:>8.2f} {p99:>8.2f} {each[0]:>6.2f}-{each[-1]:<5.2f} {cpu:>7.2f}"
            f" {p99 / by_client[0][2]:>10.2f}"
        )


def _medians(runs: Iterable[tuple[float, ...]]) -> tuple[float, ...]:
    return tuple(statistics.median(figures) for figures in zip(*runs, strict=True))


def _console(session: Path, environ: Mapping[str, str] = {}) -> Watched:
    return Watched("-m", "rsb_console", "run", str(session), environ=environ)


def _alone(
    name: str,
    environ: dict[str, str],
    *kinds: str,
    program: tuple[str, ...] = ("bench.console_alone", "500"),
    landmark: bytes = b"Topics",
) -> None:
    console = Watched("-m", *program, *kinds, environ=environ)
    try:
        painted = console.until(lambda: landmark in console.terminal.output)
        time.sleep(2.0)
        cpu, written = console.cpu(), console.written
        time.sleep(SECONDS)
        cpu, written = console.cpu() - cpu, console.written - written
        keys = sorted(_key(console, index) for index in range(KEYS))
    finally:
        console.stop()
    print(
        f"{name:>8} {painted:>10.2f} s {100 * cpu / SECONDS:>12.1f} % {written / SECONDS / 1e3:>5.1f} kB/s"
        f" {1e3 * statistics.median(keys):>5.0f} ms {1e3 * keys[-1]:>7.0f} ms"
    )


def _key(console: Watched, index: int) -> float:
    """Open or close the help; how long until it shows, s."""
    time.sleep(0.11)  # between refreshes, at every phase of them
    mark = console.written
    word = b"Next line" if index % 2 == 0 else b"STATE"
    console.terminal.type("?" if index % 2 == 0 else "q")
    return console.until(lambda: word in console.terminal.output[mark:])


def _carried(client: Callable[[Path], bed.Process] | None) -> tuple[float, ...]:
    """Messages lost; p50 and p99, ms; CPU of the client, s."""
    with bed.bridged("tcp", client) as between:
        process = between.between[0]
        cpu = process.cpu()
        run = between.send(RATE, SECONDS, SIZE)
        return run.sent - run.received, run.p50, run.p99, process.cpu() - cpu


if __name__ == "__main__":
    main()
