"""Prints the time that a bridge adds to a call, compared with no bridge and a bare proxy: ``python -m bench.calls``.

A typed rclpy client calls a typed rclpy server: in one domain, from one domain to another through one process that
hands raw requests and responses on, and through our two processes. All run at once and take turns, round by round; the
figures are the medians of the rounds, so that other load on the machine affects all equally. A second table has 200
services of ten nodes: s from their start until a client sees them all, and the figures of calls to them.

``python -m bench.calls ROUNDS`` gives each that many turns. It is part of ``make bench``.
"""

from __future__ import annotations

import base64
import contextlib
import os
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.support.calls import TYPE, CallNode, Outcome
from tests.support.locks import two_domains

from bench import bed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROUNDS = 5
NODES, EACH = 10, 20
_KINDS = ("direct", "proxy", "tcp")
_QUIET = 20.0
_TURN = 10
"""Calls of each of the 200 services."""


class Load(NamedTuple):
    """One row.

    Attributes:
        what: for people.
        how: argument of `CallNode.call`.
    """

    what: str
    how: dict[str, Any]


LOADS = (
    Load("10 calls/s", {"count": 70, "rate": 10.0}),  # the median of the slowest of 70 is the 99th percentile
    Load("one at a time", {"count": 500}),
    Load("1,000 calls/s", {"count": 2000, "rate": 1000.0, "at_once": 4000}),
    Load("2,000 calls/s", {"count": 4000, "rate": 2000.0, "at_once": 4000}),
    Load("64 at once", {"count": 4000, "at_once": 64}),
    Load("1,000 at once", {"count": 4000, "at_once": 1000}),
    Load("112 kB responses", {"count": 60, "response": 112_000}),
    Load("5 MB both ways", {"count": 5, "size": 5_000_000, "response": 5_000_000}),
)


class Run(NamedTuple):
    """One turn: calls a second, ms until an answer, µs of CPU a call of what is between (its whole)."""

    rate: float
    p50: float
    p99: float
    cpu: float


class Bed(NamedTuple):
    """A client, a service that it calls, and what is between them."""

    near: CallNode
    service: str
    between: list[bed.Process]

    def run(self, load: Load) -> Run:
        before = self._cpu()
        outcome = self.near.call(self.service, quiet=_QUIET, **load.how)
        _check(load.what, self.service, outcome)
        cpu = self._cpu() - before
        return Run(outcome.rate, 1e3 * outcome.p50, 1e3 * outcome.p99, 1e6 * cpu / outcome.wanted)

    def _cpu(self) -> float:
        return sum(process.cpu() for process in self.between)


class Many(NamedTuple):
    """200 services: s until all can be called, s that calls of all at once take; ms of one call after another."""

    seen: float
    answered: float
    p50: float
    p99: float


def main() -> None:
    report(int(sys.argv[1]) if sys.argv[1:] else ROUNDS)


def report(rounds: int) -> None:
    before = f"load average before it {os.getloadavg()[0]:.1f}"
    print(f"\nCalls of a service, medians of {rounds} rounds; CPU of what is between, µs a call; {before}")
    near_domain = two_domains()
    runs: dict[tuple[str, str], list[Run]] = {}
    with contextlib.ExitStack() as resources:
        beds = _beds(resources, near_domain, near_domain + 1)
        for each in beds.values():
            each.near.waits_for(each.service)
            each.near.call(each.service, 200, at_once=8)  # warm
        for _ in range(rounds):
            for load in LOADS:
                for kind, each in beds.items():
                    runs.setdefault((load.what, kind), []).append(each.run(load))
    _print({at: Run(*(median(column) for column in zip(*each, strict=True))) for at, each in runs.items()})
    _print_many({kind: _many(kind, near_domain, near_domain + 1) for kind in ("direct", "tcp")})


def _check(what: str, service: str, outcome: Outcome) -> None:
    if not outcome.right:
        raise SystemExit(f"{what} through {service}: {outcome}")


def _beds(resources: contextlib.ExitStack, near_domain: int, far_domain: int) -> dict[str, Bed]:
    near, far, beside = (
        resources.enter_context(contextlib.closing(CallNode(domain)))
        for domain in (near_domain, far_domain, near_domain)
    )
    beside.serve("/direct")
    far.serve("/proxy", "/tcp")
    proxy = bed.Process("-m", "bench.proxy", str(near_domain), str(far_domain), "/proxy", TYPE)
    between = {
        "direct": [],
        "proxy": [resources.enter_context(proxy)],
        "tcp": resources.enter_context(_bridged(near_domain, far_domain, ["/tcp"])),
    }
    return {kind: Bed(near, f"/{kind}", between[kind]) for kind in _KINDS}


@contextlib.contextmanager
def _bridged(near_domain: int, far_domain: int, services: Sequence[str]) -> Iterator[list[bed.Process]]:
    """Run our bridge: two processes, encrypted."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as processes:
        folder = Path(name)
        (folder / "bench.key").write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        (folder / "bench.key").chmod(0o600)
        common = f"name: bench\nserver_ip: 127.0.0.1\nserver_port: {bed.free_port()}\nkey_file: bench.key\n"
        entries = "".join(f"  - {{service: {each}, provider: server}}\n" for each in services)
        (folder / "server.yaml").write_text(f"role: server\ndomain_id: {far_domain}\n{common}")
        (folder / "client.yaml").write_text(f"role: client\ndomain_id: {near_domain}\n{common}services:\n{entries}")
        yield [processes.enter_context(bed.headless(folder / f"{role}.yaml")) for role in ("server", "client")]


def _many(kind: str, near_domain: int, far_domain: int) -> Many:
    """Measure a client of 200 services that start while everything else runs."""
    names = [f"/many_{kind}_{node}_{number}" for node in range(NODES) for number in range(EACH)]
    with contextlib.ExitStack() as resources:
        server_domain = near_domain if kind == "direct" else far_domain
        near, far = (resources.enter_context(contextlib.closing(CallNode(d))) for d in (near_domain, server_domain))
        first = f"/first_{kind}"
        if kind == "tcp":
            resources.enter_context(_bridged(near_domain, far_domain, [first, *names]))
        far.serve(first)
        near.waits_for(first)
        _check("the first call", first, near.call(first, quiet=_QUIET))
        near.ready(*names)  # its clients are there
        began = time.monotonic()
        for at, name in enumerate(names):
            far.serve(name, node=f"server{at // EACH}")
        near.waits_for(*names)
        seen = time.monotonic() - began
        began = time.monotonic()
        for name in names:
            near.begin(name, _TURN, at_once=_TURN)
        for name in names:
            _check(f"{len(names)} services", name, near.settled(name, _QUIET))
        answered = time.monotonic() - began
        outcome = near.call(names[0], 300, quiet=_QUIET)
        _check("one of many", names[0], outcome)
        return Many(seen, answered, 1e3 * outcome.p50, 1e3 * outcome.p99)


def _print(runs: dict[tuple[str, str], Run]) -> None:
    _row("", "", "p50, ms", "p99, ms", "added p50", "added p99", "calls/s", "/direct", "/proxy", "CPU")
    for load in LOADS:
        direct, proxy, _ = (runs[load.what, kind] for kind in _KINDS)
        for kind in _KINDS:
            run = runs[load.what, kind]
            ratios = (f"{run.rate / other.rate:.2f}" for other in (direct, proxy))
            latency = (run.p50, run.p99, run.p50 - direct.p50, run.p99 - direct.p99)
            cells = *(f"{each:.2f}" for each in latency), f"{run.rate:.0f}", *ratios, f"{run.cpu:.0f}"
            _row(load.what if kind == "direct" else "", kind, *cells)


def _print_many(runs: dict[str, Many]) -> None:
    count = NODES * EACH
    print(f"\n{count} services of {NODES} nodes; {_TURN} calls of each at once, then calls of a single service in turn")
    _row("", "", "seen, s", "answered, s", "p50, ms", "p99, ms")
    for kind, run in runs.items():
        _row("", kind, *(f"{each:.2f}" for each in run))


def _row(what: str, *cells: str) -> None:
    print(f"{what:<17}" + "".join(f"{cell:>12}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
