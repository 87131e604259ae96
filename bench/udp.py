"""UDP's figures alone: ``python -m bench.udp [RATE:SIZE ...]``. CPU of both sides, share delivered, added latency.

Datagrams without room in a socket's receive buffer are counted, too: no other program should use UDP meanwhile.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench import bed

LOADS = ((5_000, 2_500), (10_000, 2_500), (30_000, 2_500), (1_000, 100_000), (3_000, 100_000))
LARGE = ((100, 1_000_000), (250, 1_000_000), (30, 6_000_000))
_SECONDS = 2.0


def main() -> None:
    loads = [tuple(map(int, each.split(":"))) for each in sys.argv[1:]] or [*LOADS, *LARGE]
    print("    Hz     bytes  reached delivered  CPU, us  p50, ms  p99, ms  no room")
    with bed.bridged("udp") as between:
        for rate, size in loads:
            before = _no_room()
            run = between.send(rate, _SECONDS, size)
            print(
                f"{rate:6} {size:9} {run.rate:8.0f} {run.received / run.sent:9.3f} {run.cpu_per_message:8.0f} "
                f"{run.p50:8.2f} {run.p99:8.2f} {_no_room() - before:8}",
                flush=True,
            )


def _no_room() -> int:
    """Count the datagrams that the kernel dropped because a receive buffer was full, for all IPv4 sockets."""
    names, values = (
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    )
    return int(values[names.index("RcvbufErrors")])


if __name__ == "__main__":
    main()
