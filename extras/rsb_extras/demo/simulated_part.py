"""The demo's simulated robot and its desk: real topics, about the sizes of the thesis's table 3.1.

Run as ``python -m rsb_extras.demo.simulated_part robot|desk|listener DOMAIN [TOPIC...]``: it prints a JSON line of
message counts by topic every second, and ends with its standard input, so that it never outlives its starter. A line of
its standard input is a topic that it stops publishing. The listener subscribes to topics of simulated robots.
"""

from __future__ import annotations

import argparse
import json
import select
import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_extras.demo.simulated_node import SimulatedNode


def main() -> None:
    """Simulate until standard input ends."""
    parser = argparse.ArgumentParser(prog="python -m rsb_extras.demo.simulated_part", description=__doc__)
    parser.add_argument("part", choices=("robot", "desk", "listener"))
    parser.add_argument("domain", type=int)
    parser.add_argument("topics", nargs="*")
    arguments = parser.parse_args()
    simulation = _part(arguments.part, arguments.domain, arguments.topics)
    next_line = 0.0
    while True:
        if select.select([sys.stdin], [], [], 0)[0]:
            line = sys.stdin.readline()
            if not line:
                break
            simulation.muted.add(line.strip())
        simulation.spin_once(0.1)
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + 1.0
            _report(simulation)
    _report(simulation)
    simulation.close()


def _part(name: str, domain: int, topics: Sequence[str]) -> SimulatedNode:
    # Each part imports the messages that it needs.
    if name == "robot":
        from rsb_extras.demo.simulated_robot import SimulatedRobot  # noqa: PLC0415

        return SimulatedRobot(domain)
    from rsb_extras.demo.simulated_desk import Desk, FleetListener  # noqa: PLC0415

    return Desk(domain) if name == "desk" else FleetListener(domain, topics)


def _report(simulation: SimulatedNode) -> None:
    sys.stdout.write(json.dumps({"published": simulation.published, "received": simulation.received}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
