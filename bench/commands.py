"""Measures the gaps in the commands of an armed topic on a link that loses packets: ``python -m bench.commands``.

A node on a control PC publishes commands, and a node on a robot hears them. Both live in network namespaces of
their own, with our bridge between them, on a cable that loses some of the packets both ways. A topic that disarms is
armed again at once, which the table counts. It needs root, iproute2 and nftables.
"""

from __future__ import annotations

import argparse
import subprocess
import time
from contextlib import ExitStack
from itertools import pairwise
from typing import TYPE_CHECKING

from bench.cable_bed import PC, cabled
from tests.network.bridging import COMMAND
from tests.network.hosts import NoHostError
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.network.bridging import Bridge
    from tests.network.hosts import Host

_TOPIC = "/cmd"
_RATE = 10.0
"""Hz: a driver's keys and most joysticks are that fast."""
_GAP = 0.3
"""s without a command, after which many bases stop by themselves."""
_WITHIN = 60.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loss", type=int, default=30, help="per cent of the packets, each way")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--protocols", default="udp,tcp")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(f"{options.loss} % lost, {_RATE:g} Hz, {options.seconds:g} s")
    print(f"protocol | arrived | p50, worst ms | longest gaps, s | over 1 s | time in gaps over {_GAP:g} s | armed")
    for _ in range(options.rounds):
        for protocol in options.protocols.split(","):
            try:
                print(_run(protocol, options.loss, options.seconds), flush=True)
            except NoHostError as error:
                raise SystemExit(f"no namespaces: {error}; run this as root") from None


def _run(protocol: str, loss: int, seconds: float) -> str:
    with ExitStack() as stack:
        network, robot, pc, cable = stack.enter_context(cabled())
        cable.single()
        # `deadman` is 0, since nobody presses keys.
        entry = {"topic": _TOPIC, "protocol": protocol, "direction": "receive", "arm": True, "deadman": 0}
        bridge = network.bridge(robot, pc, PC, entry)
        bridge.pc.talk(_TOPIC, rate=_RATE, size=100)
        eventually(lambda: bridge.server.route(_TOPIC).get("state") == "disarmed", _WITHIN)
        arming, times = _arm(stack, bridge, pc), 1
        bridge.robot.listen(_TOPIC)
        bridge.robot.hears(_TOPIC)
        cable.lose(loss)
        began = time.time()
        while time.time() < began + seconds:
            if arming.poll() is not None:
                arming, times = _arm(stack, bridge, pc), times + 1
            time.sleep(0.05)
        ended = time.time()
        heard = [each for each in bridge.robot.heard(_TOPIC) if began < each.came / 1e9 < ended]
    came = [began, *(each.came / 1e9 for each in heard), ended]
    gaps = sorted((later - earlier for earlier, later in pairwise(came)), reverse=True)
    ages = sorted(each.latency * 1e3 for each in heard) or [float("nan")]
    in_gaps = sum(gap for gap in gaps if gap > _GAP) / (ended - began)
    longest = " ".join(f"{gap:.2f}" for gap in gaps[:3])
    return (
        f"{protocol} | {len(heard) / (_RATE * (ended - began)):.0%} | {ages[len(ages) // 2]:.0f}, {ages[-1]:.0f} | "
        f"{longest} | {sum(gap > 1 for gap in gaps)} | {in_gaps:.1%} | {times}"
    )


def _arm(stack: ExitStack, bridge: Bridge, pc: Host) -> subprocess.Popen[str]:
    null = subprocess.DEVNULL
    words = ("arm", _TOPIC, "--control", str(bridge.server.control))
    started = pc.start(str(COMMAND), *words, stdin=null, stdout=null, stderr=null)
    stack.callback(started.kill)
    return started


if __name__ == "__main__":
    main()
