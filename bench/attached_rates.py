"""Prints what attached consoles do to the messages of a bridge: ``python -m bench.attached_rates``, seven minutes.

One bridge carries a steady stream, and is measured by turns without a console and with: one; one after the other that
is killed; one that is stopped, as by a terminal that stalls; and twenty. The last columns are ratios to none.
"""

from __future__ import annotations

import contextlib
import os
import signal
import statistics
import tempfile
import threading
from typing import TYPE_CHECKING, NamedTuple

from bench import bed
from bench.console import OVER_SSH, Watched

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

RATE, SIZE, SECONDS, ROUNDS = 2_000, 2_500, 10.0, 3
STALLED, TWENTY = 30.0, 20
KILLED_AFTER = 1.0


def main(rounds: int = ROUNDS) -> None:
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = name
        with bed.bridged("tcp") as between:
            print(f"a bridge carrying {RATE} msg/s of {SIZE} bytes over TCP, and consoles at 2 Hz; medians of {rounds}")
            print(f"{'consoles':>18} {'delivered':>10} {'lost':>5} {'p50 ms':>7} {'p99 ms':>7}{'rate':>13}   p50   p99")
            for words, consoles, seconds in (
                ("one", _one, SECONDS),
                ("killed, by turns", _killed, SECONDS),
                (f"stopped for {STALLED:.0f} s", _stopped, STALLED),
                (f"{TWENTY} at once", _twenty, SECONDS),
            ):
                pairs = [(_run(between, _none, SECONDS), _run(between, consoles, seconds)) for _ in range(rounds)]
                _print(words, pairs)


class Figures(NamedTuple):
    """Received messages a second, lost messages, and latencies in ms."""

    delivered: float
    lost: float
    p50: float
    p99: float


def _run(between: bed.Bed, consoles: Callable[[], AbstractContextManager[None]], seconds: float) -> Figures:
    with consoles():
        run = between.send(RATE, seconds, SIZE)
    return Figures(run.rate * run.received / run.sent, run.sent - run.received, run.p50, run.p99)


def _print(words: str, pairs: Sequence[tuple[Figures, Figures]]) -> None:
    for name, runs in (("none", [none for none, _ in pairs]), (words, [some for _, some in pairs])):
        delivered, lost, p50, p99 = map(statistics.median, zip(*runs, strict=True))
        print(f"{name:>18} {delivered:>8.0f}/s {lost:>5.0f} {p50:>7.2f} {p99:>7.2f}", end="" if name == words else "\n")
    rate, p50, p99 = (
        statistics.median(getattr(some, name) / getattr(none, name) for none, some in pairs)
        for name in ("delivered", "p50", "p99")
    )
    print(f"{rate:>13.3f} {p50:>5.2f} {p99:>5.2f}", flush=True)


@contextlib.contextmanager
def _none() -> Iterator[None]:
    yield


@contextlib.contextmanager
def _attached(count: int) -> Iterator[list[Watched]]:
    consoles = [Watched("-m", "rsb_console", "attach", "bench-2", environ=OVER_SSH) for _ in range(count)]
    try:
        for each in consoles:
            each.until(lambda c=each: bed.TOPIC.encode() in c.terminal.output, 60.0)  # type: ignore[misc]
        yield consoles
    finally:
        for each in consoles:
            each.stop()


@contextlib.contextmanager
def _one() -> Iterator[None]:
    with _attached(1):
        yield


@contextlib.contextmanager
def _twenty() -> Iterator[None]:
    with _attached(TWENTY):
        yield


@contextlib.contextmanager
def _stopped() -> Iterator[None]:
    with _attached(1) as (console,):
        os.kill(console.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(console.pid, signal.SIGCONT)


@contextlib.contextmanager
def _killed() -> Iterator[None]:
    """Attach one after the other, and kill each a second later."""
    ends = threading.Event()

    def work() -> None:
        while not ends.is_set():
            with _attached(1) as (console,):
                ends.wait(KILLED_AFTER)
                os.kill(console.pid, signal.SIGKILL)

    killing = threading.Thread(target=work)
    killing.start()
    try:
        yield
    finally:
        ends.set()
        killing.join()


if __name__ == "__main__":
    main()
