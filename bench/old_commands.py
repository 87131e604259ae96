"""Counts the old commands that a robot gets after a cut: ``python -m bench.old_commands`` prints a row a topic.

A node on a control PC publishes at 50 Hz on topics that may move a robot, and a node on a robot listens. Both live in
network namespaces of their own, with our bridge between them, on a cable that is cut for some seconds. *Old* are
messages that came more than 0.5 s after they were published, with the oldest one's age in s; *until* is how long after
the cut the last of these came. *State* is a topic that moves nothing: of its messages *live* says how long after its
first message it took until one was younger than 0.2 s. It needs root, iproute2 and nftables.
"""

from __future__ import annotations

import argparse
import time
from copy import deepcopy
from typing import TYPE_CHECKING, Any

from bench.cable_bed import PC, cabled
from tests.network.hosts import NoHostError
from tests.network.outage_counts import LIVE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tests.network.node import Heard

_RATE = 50.0
_OLD = 0.5
_BEFORE, _AFTER = 12.0, 8.0  # s of traffic around a cut
_QOS: dict[str, Any] = {"auto": "auto", "1": 1, "keep_all": {"history": "keep_all"}}
_COMMANDS = "/cmd_vel", "/arm/joint_trajectory", "/controller/commands"
_STATE = "/joint_states"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuts", default="2,6", help="s")
    parser.add_argument("--protocols", default="tcp,udp")
    parser.add_argument("--qos", default=",".join(_QOS), help=", ".join(_QOS))
    options = parser.parse_args()
    cuts = [float(each) for each in options.cuts.split(",")]
    print("| transport | qos | topic | cut, s | published | came | old | oldest, s | until, s | live, s |")
    print("|---" * 10 + "|", flush=True)
    for protocol in options.protocols.split(","):
        for qos in options.qos.split(","):
            try:
                for row in _rows(protocol, qos, cuts):
                    print(row, flush=True)
            except NoHostError as error:
                raise SystemExit(f"no namespaces: {error}; run this as root") from None


def _rows(protocol: str, qos: str, cuts: Sequence[float]) -> Iterator[str]:
    with cabled() as (network, robot, pc, cable):
        topics = (*_COMMANDS, _STATE)
        # Each a copy of its own: YAML would write the same one as an alias.
        common = {"protocol": protocol, "direction": "receive"}
        entries = [common | {"topic": each, "qos": deepcopy(_QOS[qos])} for each in topics]
        bridge = network.bridge(robot, pc, PC, *entries)
        for topic in topics:
            bridge.pc.talk(topic, rate=_RATE)
        bridge.listen(robot=topics)
        for topic in topics:
            bridge.robot.hears(topic)
        for cut in cuts:
            time.sleep(_BEFORE)
            began = time.time_ns()
            cable.cut()
            time.sleep(cut)
            cable.mend()
            back = time.time_ns()
            time.sleep(_AFTER)
            for topic in topics:
                heard = [each for each in bridge.robot.heard(topic) if each.sent > began - 10**9]
                yield f"| {protocol} | {qos} | {topic} | {cut:g} | {_figures(heard, back)} |"


def _figures(heard: Sequence[Heard], back: int) -> str:
    after = [each for each in heard if each.came > back]
    old = [each for each in after if each.latency > _OLD]
    until = (max(each.came for each in old) - back) / 1e9 if old else 0.0
    published = heard[-1].number - heard[0].number + 1 if heard else 0
    live = next((each.came for each in after if each.latency < LIVE), None)
    live_after = "never" if live is None else f"{(live - after[0].came) / 1e9:.1f}"
    oldest = max((each.latency for each in after), default=0.0)
    return f"{published} | {len(heard)} | {len(old)} | {oldest:.1f} | {until:.1f} | {live_after}"


if __name__ == "__main__":
    main()
