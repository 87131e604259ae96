"""Run for as long as told: ``make soak [SECONDS=1800]`` or ``python -m tests.soak [--seconds N]``."""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tests.soak.worlds import Worlds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.soak.faults import Fault
    from tests.soak.run import Outcome

CLIENTS = 3
RECOVERY = 15.0
_AUDITED = 20.0
_DOMAINS = range(60, 80, CLIENTS + 1)
"""The first of a run's domains, which follow each other."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--seconds", type=float, default=1800.0, help="how long (default: 1800)")
    parser.add_argument("--seed", type=int, default=None, help="of the faults (default: a new one)")
    parser.add_argument("--only", choices=("worlds", "processes"), help="one of the two parts")
    arguments = parser.parse_args()
    seed = random.SystemRandom().randrange(10**6) if arguments.seed is None else arguments.seed
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by SIGTERM"))
    tell(f"soak: seed {seed}, {arguments.seconds:g} s")
    worlds = None if arguments.only == "processes" else Worlds(random.Random(f"{seed} worlds"))
    outcome, folder = None, Path(tempfile.mkdtemp(prefix="rsb-console-soak-"))
    if worlds:
        worlds.start()
    try:
        ends = time.monotonic() + arguments.seconds
        if arguments.only != "worlds":
            outcome = _processes(folder, seed, arguments.seconds)
        while worlds and time.monotonic() < ends:
            time.sleep(1.0)
    finally:
        if worlds:
            worlds.stop()
    return _report(outcome, worlds, folder)


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _processes(folder: Path, seed: int, seconds: float) -> Outcome:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # before anything joins a domain
    from tests.soak.run import play
    from tests.soak.stage import Stage

    chance = random.Random(f"{seed} faults")
    with _domains() as first:
        stage = Stage(folder, range(first, first + CLIENTS + 1))
        try:
            return play(stage, _faults(chance, seconds), chance, audited=_AUDITED, tell=tell)
        finally:
            stage.close()


def _faults(chance: random.Random, seconds: float) -> Iterator[Fault]:
    from tests.soak.faults import draw

    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds - _AUDITED:
        yield draw(chance, CLIENTS, passed / seconds)


@contextlib.contextmanager
def _domains() -> Iterator[int]:
    """The first of some domains that no other soak on this machine uses."""
    for domain_id in _DOMAINS:
        with (Path(tempfile.gettempdir()) / f"rsb-console-soak-{domain_id}").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain_id
            return
    sys.exit(f"domains from {_DOMAINS} on are all in use by other soaks")


def _report(outcome: Outcome | None, worlds: Worlds | None, folder: Path) -> int:
    from tests.soak import report

    reasons = []
    if outcome:
        tell(f"\n{report.of_processes(outcome)}")
        reasons += report.broken(outcome, RECOVERY)
    if worlds:
        tell(f"\n{report.of_worlds(worlds)}")
        reasons += [f"a world failed: {failure}" for failure in worlds.failures]
    if not reasons:
        tell("\nall bounds hold")
        shutil.rmtree(folder)
        return 0
    if outcome:
        report.write_samples(outcome.lives, folder / "samples.csv")
    tell(f"\nBROKEN; sessions, logs and samples are in {folder}")
    for reason in reasons:
        tell(f"- {reason}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
