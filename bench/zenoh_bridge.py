"""zenoh-bridge-ros2dds between two domains, for comparison: its plugin in a program that ``make peers`` builds.

``python -m bench.zenoh_bridge DOMAIN listen|connect ENDPOINT`` becomes one side of it. It ends with its standard input.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_console.session.demo_session import free_port
from rsb_console.simulated.processes import Process, listening

if TYPE_CHECKING:
    from collections.abc import Iterator

NAME = "zenoh-bridge"
PROGRAM = Path(__file__).parent / "peers/zenoh_bridge/target/release/zenoh_bridge"
_CYCLONE = (
    "<CycloneDDS><Domain><General>"
    "<Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "</General></Domain></CycloneDDS>"
)
"""Without it, Cyclone DDS takes another interface than loopback, on which nodes of `LOCALHOST` do not answer."""


def check_built() -> None:
    """End this process with a sentence if the program is not built."""
    if not PROGRAM.exists():
        raise SystemExit("zenoh-bridge-ros2dds is not built: run `make peers`")


@contextlib.contextmanager
def between(near: int, far: int) -> Iterator[list[Process]]:
    """Start a side in each domain, and yield the sending and the receiving one. Their topics open some time later."""
    check_built()
    port = free_port()
    with _side(far, "listen", port) as receiving:
        listening(receiving, port)
        with _side(near, "connect", port) as sending:
            yield [sending, receiving]


def _side(domain: int, part: str, port: int) -> Process:
    arguments = (str(domain), part, f"tcp/127.0.0.1:{port}")
    return Process("-m", "bench.zenoh_bridge", *arguments, environ={"CYCLONEDDS_URI": _CYCLONE})


def main() -> None:
    # The process stays the same, so that its CPU time and memory are found by its number.
    os.execv(PROGRAM, [PROGRAM.name, *sys.argv[1:]])


if __name__ == "__main__":
    main()
