"""Measures the cost of strangers in a Zenoh network for a link: memory, CPU, log lines, and the messages that cross.

``python -m bench.zenoh_strangers [SECONDS]``: one attack after another, each against a link of its own that carries 50
messages a second. The messages are counted by their publisher and their listener.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from tests.support.bridge import Bridge, linked
from tests.support.domain import Domain, text
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.tests.zenoh_attacker import ATTACKS, Attacker
from rsb_extras.zenoh.tests.zenoh_router import Router

_HZ = {"churn": 100.0}
_PAGE = os.sysconf("SC_PAGE_SIZE")


def _rss() -> float:
    """MB of this process, in which both sides run."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 1e6


def _run(attack: str, seconds: float, router: Router, robot: Domain, pc: Domain, folder: Path) -> str:
    bridge = Bridge(folder, robot, pc)
    over = {"server_ip": "zenoh", "server_port": 0, "features": {"zenoh": ZenohSettings(connect=(router.endpoint,))}}
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    server, client = bridge.both(Topic("/odom", "transmit", qos={"depth": 100}), **over)

    def crosses() -> bool:
        out.publish(text("ready"))
        time.sleep(0.05)
        return bool(there.payloads)

    eventually(crosses)
    eventually(lambda: there.payloads.count(text("ready")) > 0)
    time.sleep(1.0)
    published, before, lines = 0, len(there.payloads), sum(len(each.events()) for each in (server, client))
    memory, cpu, began = _rss(), time.process_time(), time.monotonic()
    sent = {}
    attacker = None if attack == "none" else Attacker(router.endpoint, attack, hz=_HZ.get(attack, 50.0))
    try:
        while time.monotonic() - began < seconds:
            out.publish(text(f"odom {published}"))
            published += 1
            time.sleep(0.02)
        sent = {} if attacker is None else attacker.stop()
    finally:
        if attacker is not None:
            attacker.close()
    used = (time.process_time() - cpu) / (time.monotonic() - began)
    time.sleep(1.0)
    lost = sum(each.code == EventCode.LINK_LOST for engine in (server, client) for each in engine.events())
    line = (
        f"{attack:11} {sum(sent.values()) / seconds:8.0f}/s  crossed {len(there.payloads) - before}/{published}  "
        f"links lost {lost}  linked {linked(client)}  CPU {used:4.0%}  RSS {_rss() - memory:+6.1f} MB  "
        f"log lines {sum(len(each.events()) for each in (server, client)) - lines}"
    )
    bridge.close()
    return line


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    router, robot, pc = Router(), Domain(81), Domain(82)
    with closing(router), closing(robot), closing(pc):
        for attack in ("none", *(each for each in ATTACKS if each != "answers")):
            with tempfile.TemporaryDirectory() as folder:
                print(_run(attack, seconds, router, robot, pc, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
