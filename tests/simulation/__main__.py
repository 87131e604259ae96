"""Play worlds: ``python -m tests.simulation SEED [--days N]``."""

from __future__ import annotations

import argparse
import sys
import time

from tests.simulation.world import Violation, World


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("seed", type=int, help="which world")
    parser.add_argument("--days", type=float, default=1.0, help="how long it lives (default: 1)")
    parser.add_argument("--log", type=int, default=60, help="lines to show after a failure (default: 60)")
    arguments = parser.parse_args()
    world = World(arguments.seed)
    began = time.process_time()
    failure: Violation | None = None
    try:
        world.play(arguments.days * 86_400)
    except Violation as violation:
        failure = violation
    spent = time.process_time() - began
    if failure is not None:
        sys.stdout.write("".join(f"{line}\n" for line in list(world.log.lines)[-arguments.log :]))
        sys.stdout.write(f"\n{failure}\n\n")
    sys.stdout.write(f"{world.summary()}\n{spent:.1f} s of CPU time\n")
    return 1 if failure else 0


if __name__ == "__main__":
    sys.exit(main())
