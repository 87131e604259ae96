"""Measures how live a latched topic stays: ``python -m bench.latched`` prints a line for each rate.

Node loggers publish on /rosout (latched, lifespan 10 s), or with ``--topic`` plain latched publishers without a
lifespan. A subscriber of depth 500 listens behind a bridge between two domains. A line has the messages sent and heard,
the messages out of order, the time from the first publication to the first message heard, and to the first that a
subscriber on the near side hears (DDS finds a new publisher late on a busy machine), latencies, how many messages
a late joiner on the far side misses of the messages that one on the near side gets, how many it gets beyond these,
and the sender's ledger.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.bed import FAR, NEAR, Process

from rsb_bridge.control.remote_engine import attach
from rsb_extras.bench.loopback import headless, write_sessions
from rsb_extras.demo.processes import listening

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Ledger

ROSOUT, PLAIN = "/rosout", "/plain"
RATES = (1, 10, 25, 50, 200)
DEPTH = 500
_KEPT = 1000
"""Depth of the publishers, as rcl's own for /rosout."""
_SETTLES = 2.5
"""s for messages in transit, and for late joiners to get histories."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rates", default=",".join(map(str, RATES)), help="Hz, of all publishers together")
    parser.add_argument("--publishers", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--topic", dest="name", action="store_const", const=PLAIN, default=ROSOUT)
    parser.add_argument("--depth", type=int, default=_KEPT, help="of publishers of --topic")
    parser.add_argument("--known", action="store_true", help="publish once DDS has found the bridge, and not at once")
    options = parser.parse_args()
    print("Hz | sent | heard | out of order | first s, near | p50 ms | max ms | late missing, more | ledger")
    for rate in map(float, options.rates.split(",")):
        print(_measure(options, rate), flush=True)


def _measure(options: argparse.Namespace, rate: float) -> str:
    name = options.name
    ends = [name, str(options.depth)]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rsb-latched-")))
        listener = stack.enter_context(Process("-m", "bench.latched_ends", "listen", *ends))
        listener.line()
        port = write_sessions(folder, NEAR, FAR, [f"  - {{topic: {name}, direction: transmit}}"])
        listening(stack.enter_context(headless(folder / "server.yaml")), port)
        stack.enter_context(headless(folder / "client.yaml"))
        while not listener.ask("matched")["matched"]:
            time.sleep(0.1)
        time.sleep(1)
        talker = stack.enter_context(
            Process("-m", "bench.latched_ends", "talk", *ends, str(options.publishers), str(int(options.known)))
        )
        talker.line()
        count = max(1, int(rate * options.seconds))
        first = talker.ask(f"{rate} {count}")["first"]
        time.sleep(_SETTLES)
        heard: dict[str, Any] = listener.ask("report")
        ledger = _ledger(folder / "client.sock", name)
        talker.stop()
        since, near = ((heard[each] - first) / 1e9 for each in ("first", "first_near"))
        return (
            f"{rate:g} | {count} | {heard['heard']} | {heard['disorder']} | {since:.3f}, {near:.3f} | "
            f"{heard['p50']:.1f} | {heard['max']:.0f} | "
            f"{heard['missing']} of {heard['near']}, {heard['more']} | {_words(ledger)}"
        )


def _ledger(socket: Path, topic: str) -> Ledger:
    with attach(socket, read_only=True) as engine:
        deadline = time.monotonic() + 5
        while time.monotonic() < deadline:
            routes = [each for each in engine.snapshot().routes if each.topic == topic]
            if routes and routes[0].ledger.offered:
                time.sleep(1.1)
                return next(each.ledger for each in engine.snapshot().routes if each.topic == topic)
            time.sleep(0.1)
    raise SystemExit("the bridge has no ledger")


def _words(ledger: Ledger) -> str:
    rest = f", {ledger.expired} expired" if ledger.expired else ""
    return f"{ledger.offered} offered, {ledger.delivered} delivered, {ledger.dropped or 'none'} dropped{rest}"


if __name__ == "__main__":
    main()
