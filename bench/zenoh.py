"""Links over Zenoh compared with TCP: ``python -m bench.zenoh [ROUNDS]``. CPU of both sides, share delivered, latency.

Each round measures all networks in turn. ``router``: both sides connect to a router, a separate process whose CPU is
not counted; ``peer``: the client connects to the server. Ratios are of the same round.
"""

from __future__ import annotations

import contextlib
import json
import re
import statistics
import subprocess
import sys
from collections import defaultdict
from typing import TYPE_CHECKING

from bench import bed
from rsb_console.bench import loopback

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rsb_console.bench.loopback import Bed
    from rsb_console.bench.processes import Process

LOADS = ((100, 2_500), (1_000, 2_500), (10_000, 2_500), (100, 1_000_000))
ROUNDS, SECONDS = 3, 3.0
_ROUTER = """
import sys, zenoh
session = zenoh.open(zenoh.Config.from_json5(sys.argv[1]))
print("up", flush=True)
sys.stdin.read()
"""
_ADDRESS = re.compile(r"server_ip: 127\.0\.0\.1\nserver_port: (\d+)\n")


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    ways: dict[str, Callable[[], contextlib.AbstractContextManager[Bed]]] = {
        "tcp": lambda: bed.bridged("tcp"),
        "zenoh, router": lambda: _over_zenoh("zenoh", routed=True),
        "zenoh, peer": lambda: _over_zenoh("zenoh", routed=False),
        "zenoh-drop, router": lambda: _over_zenoh("zenoh-drop", routed=True),
    }
    figures: dict[tuple[str, tuple[int, int]], list[tuple[float, ...]]] = defaultdict(list)
    for _ in range(rounds):
        for way, make in ways.items():
            with make() as between:
                for rate, size in LOADS:
                    run = between.send(rate, SECONDS, size)
                    figures[way, (rate, size)].append((run.cpu_per_message, run.p50, run.p99, run.received / run.sent))
    print(f"{'way':20} {'Hz':>6} {'bytes':>9} {'CPU, us':>8} {'to tcp':>7} {'p50, ms':>8} {'p99, ms':>8} delivered")
    for load in LOADS:
        for way in ways:
            cpu, p50, p99, came = (statistics.median(each) for each in zip(*figures[way, load], strict=True))
            pairs = zip(figures[way, load], figures["tcp", load], strict=True)
            ratio = statistics.median(mine[0] / tcp[0] for mine, tcp in pairs)
            print(f"{way:20} {load[0]:6} {load[1]:9} {cpu:8.0f} {ratio:7.2f} {p50:8.2f} {p99:8.2f} {came:9.3f}")


@contextlib.contextmanager
def _over_zenoh(protocol: str, *, routed: bool) -> Iterator[Bed]:
    """Put our bridge over Zenoh between them; the server's port is the router's or its own."""
    with contextlib.ExitStack() as running:

        def side(session: Path) -> Process:
            text = session.read_text()
            match = _ADDRESS.search(text)
            assert match is not None
            endpoint = f"tcp/127.0.0.1:{match[1]}"
            server = session.stem == "server"
            if server and routed:
                running.enter_context(router(endpoint))
            key = "listen" if server and not routed else "connect"
            session.write_text(_ADDRESS.sub(f"server_ip: zenoh\nzenoh: {{{key}: [{endpoint}]}}\n", text))
            return loopback.headless(session)

        yield running.enter_context(loopback.bridged(protocol, bed.NEAR, bed.FAR, side=side))


@contextlib.contextmanager
def router(endpoint: str) -> Iterator[None]:
    """Run a Zenoh router as a separate process that listens at this endpoint."""
    config = {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},  # it is killed, and would leave some behind
    }
    command = [sys.executable, "-c", _ROUTER, json.dumps(config)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as router:
        assert router.stdout is not None
        router.stdout.readline()
        try:
            yield
        finally:
            router.kill()


if __name__ == "__main__":
    main()
