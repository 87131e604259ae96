"""Calls of a service for `bench.run`: no bridge, a bare proxy, and our bridge between client and server, in turns.

A typed rclpy client calls a typed rclpy server: in one domain, from one domain to another through one process that
hands raw requests and responses on, through two bare ones with a connection between them, and through ours.
"""

from __future__ import annotations

import contextlib
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bench import bed
from bench.figures import in_turn, print_table
from tests.support.calls import TYPE, CallNode, Outcome

from rsb_extras.bench import loopback

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bench.figures import Figures

    from rsb_extras.demo.processes import Process

QUIET = 20.0
_KINDS = ("direct", "proxy", "bare-tcp", "tcp")


class Load(NamedTuple):
    """One row.

    Attributes:
        what: for people.
        how: argument of `CallNode.call`.
    """

    what: str
    how: dict[str, Any]


LOADS = (
    Load("10 calls/s", {"count": 40, "rate": 10.0}),
    Load("one at a time", {"count": 500}),
    Load("1,000 calls/s", {"count": 1000, "rate": 1000.0, "at_once": 4000}),
    Load("64 at once", {"count": 3000, "at_once": 64}),
    Load("1,000 at once", {"count": 4000, "at_once": 1000}),
    Load("112 kB responses", {"count": 40, "response": 112_000}),
    Load("5 MB both ways", {"count": 3, "size": 5_000_000, "response": 5_000_000}),
)


class Bed(NamedTuple):
    """A client, a service that it calls, and what is between them."""

    near: CallNode
    service: str
    between: list[Process]

    def run(self, load: Load) -> tuple[Outcome, float]:
        """Return the calls' outcomes, and the CPU time (s) of the processes between both ends."""
        before = self._cpu()
        outcome = self.near.call(self.service, quiet=QUIET, **load.how)
        check(load.what, self.service, outcome)
        return outcome, self._cpu() - before

    def _cpu(self) -> float:
        return sum(process.cpu() for process in self.between)


def run(figures: Figures, rounds: int, near: int) -> None:
    """Measure some rounds in a pair of domains, and print them."""
    with contextlib.ExitStack() as resources:
        beds = _beds(resources, near, near + 1)
        for each in beds.values():
            each.near.waits_for(each.service)
            each.near.call(each.service, 200, at_once=8)  # warm
        for number in range(rounds):
            for turn, load in enumerate(LOADS):
                for kind in in_turn(_KINDS, number + turn):
                    outcome, cpu = beds[kind].run(load)
                    figures.add(number, kind, f"{load.what} p50", 1e3 * outcome.p50)
                    figures.add(number, kind, f"{load.what} p99", 1e3 * outcome.p99)
                    figures.add(number, kind, f"{load.what} rate", outcome.rate)
                    figures.add(number, kind, f"{load.what} CPU", 1e6 * cpu / outcome.wanted)
    _print(figures)


def check(what: str, service: str, outcome: Outcome) -> None:
    """End the program if a call has no answer or another call's."""
    if not outcome.right:
        raise SystemExit(f"{what} through {service}: {outcome}")


def _beds(resources: contextlib.ExitStack, near_domain: int, far_domain: int) -> dict[str, Bed]:
    near, far, beside = (
        resources.enter_context(contextlib.closing(CallNode(domain)))
        for domain in (near_domain, far_domain, near_domain)
    )
    beside.serve("/direct")
    far.serve("/proxy", "/bare", "/tcp")
    proxy = bed.Process("-m", "bench.proxy", str(near_domain), str(far_domain), "/proxy", TYPE)
    between: dict[str, list[Process]] = {
        "direct": [],
        "proxy": [resources.enter_context(proxy)],
        "bare-tcp": resources.enter_context(_bare(near_domain, far_domain)),
        "tcp": resources.enter_context(bridged(near_domain, far_domain, ["/tcp"])),
    }
    return {kind: Bed(near, f"/{kind.removesuffix('-tcp')}", between[kind]) for kind in _KINDS}


@contextlib.contextmanager
def _bare(near: int, far: int) -> Iterator[list[Process]]:
    """Run the least that two processes can be."""
    port = str(bed.free_port())
    with bed.Process("-m", "bench.bare", "call", str(far), "/bare", port, TYPE) as calling:
        calling.line()  # it is ready
        with bed.Process("-m", "bench.bare", "serve", str(near), "/bare", port, TYPE) as serving:
            serving.line()
            yield [serving, calling]


@contextlib.contextmanager
def bridged(near: int, far: int, services: Sequence[str]) -> Iterator[list[Process]]:
    """Run our bridge with services: two processes, encrypted."""
    with tempfile.TemporaryDirectory(prefix="rsb-bench-") as name, contextlib.ExitStack() as processes:
        folder = Path(name)
        entries = [f"  - {{service: {each}, provider: server}}" for each in services]
        loopback.write_sessions(folder, near, far, entries, key="services")
        yield [processes.enter_context(loopback.headless(folder / f"{role}.yaml")) for role in ("server", "client")]


def _print(figures: Figures) -> None:
    rows = [load.what for load in LOADS]
    between = _KINDS[1:]
    added, ratio = partial(figures.added, other="direct"), partial(figures.ratio, other="proxy")
    print_table("Calls: p50, ms", rows, _KINDS, figures.spread, 2, "p50")
    print_table("Calls: p50 beyond no bridge, ms", rows, between, added, 2, "p50")
    print_table("Calls: p99 beyond no bridge, ms", rows, between, added, 2, "p99")
    print_table("Calls answered a second", rows, _KINDS, figures.spread, 0, "rate")
    print_table("CPU of all between client and server, µs a call", rows, between, figures.spread, 0, "CPU")
    print_table("CPU of a call, in ratio to proxy", rows, _KINDS[2:], ratio, 2, "CPU")
