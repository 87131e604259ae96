"""Prints the ledger next to counts from outside: ``python -m tests.system.counting [NAME...]``.

Each case prints its figures: kill -9 and a freeze of the receiving bridge at 2 kHz, over TCP and UDP. ``direct`` has no
bridge: a listener that is frozen for as long, or gets a burst, to know what DDS itself drops.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tests.support.counting import TOPIC, Count, CountedBridge, _Child
from tests.support.locks import two_domains
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

_RATE = 2000.0


def _case(name: str, domains: tuple[int, int]) -> Count:
    what, protocol, depth, kept = (*name.split("-"), "5000", "0")[:4] if name.count("-") < 3 else name.split("-")
    qos = {"depth": int(kept)} if int(kept) else None
    with tempfile.TemporaryDirectory() as folder:
        topic = Topic(TOPIC, "transmit", protocol=protocol, expected_rate=_RATE, qos=qos or "auto")  # type: ignore[arg-type]
        with CountedBridge(Path(folder), domains, topic, depth=int(depth)) as counted:
            counted.flows(_RATE)
            time.sleep(5)
            if what == "kill":
                counted.restart()
                before = counted.listener.ask()["heard"]
                eventually(lambda: counted.listener.ask()["heard"] > before + 1000, within=60)
            elif what == "freeze":
                counted.freeze(3)
                time.sleep(5)
            count = counted.settled()
            print(counted.server.output()[-1500:] if "-v" in sys.argv else "")  # noqa: T201
            return count


def _direct(domain: int, depth: int, freeze: float) -> str:
    listener, publisher = _Child("listen", domain, TOPIC, depth), _Child("publish", domain, TOPIC, depth)
    listener.read()
    publisher.read()
    publisher.ask(f"rate {_RATE}")
    eventually(lambda: listener.ask()["heard"] > 1000)
    time.sleep(5)
    if freeze:
        listener.freeze(freeze)
    else:
        publisher.ask("burst 6000")
    time.sleep(2)
    published = publisher.ask("rate 0")["published"]
    time.sleep(2)
    heard = listener.ask()["heard"]
    listener.close()
    publisher.close()
    return f"{published} published, {heard} received"


def main(*names: str) -> None:
    """Run the cases."""
    first = two_domains()
    for name in names or ("kill-tcp", "kill-udp", "freeze-tcp", "freeze-udp", "freeze-tcp-10"):
        if name.startswith("direct"):
            print(f"{name}: {_direct(first, int(name.split('-')[1]), float(name.split('-')[2]))}", flush=True)  # noqa: T201
        else:
            print(f"{name}: {_case(name, (first, first + 1))}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(*[each for each in sys.argv[1:] if each != "-v"])
