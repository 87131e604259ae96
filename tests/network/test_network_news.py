"""News of a network from the kernel of a machine whose devices and addresses change."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.network.bridging import EACH_WAY
from tests.network.hosts import Cable
from tests.network.outage_bed import FAULTS, FLOWS, OutageBed
from tests.network.outage_counts import count_topic
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from pathlib import Path

    from tests.network.conftest import Network
    from tests.network.hosts import Host

_LISTENS = """
import asyncio, json, sys
from rsb_bridge.transport.network_news import NetworkNews, device_of
async def listen():
    def changed():
        print(json.dumps([device_of("10.9.0.1"), news.why_silent("10.9.0.1")]), flush=True)
    news = NetworkNews(changed)
    print("{}", flush=True)
    await asyncio.sleep(600)
asyncio.run(listen())
"""


class _Listener:
    def __init__(self, host: Host, log: Path) -> None:
        self._log = log
        with log.open("w") as output:
            self._process = host.start(sys.executable, "-c", _LISTENS, stdout=output)
        eventually(self._log.read_text, what="the program listens")

    @property
    def told(self) -> list[Any]:
        whole, _, _ = self._log.read_text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()][1:]

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def test_kernel_tells_of_devices_and_addresses(network: Network, tmp_path: Path) -> None:
    here, there = network.host("here"), network.host("there")
    Cable(here, there)
    listener = _Listener(here, tmp_path / "told")
    try:
        for command, told in (
            ("ip address add 10.9.0.1/24 dev eth0", ["eth0", ""]),
            ("ip link set eth0 down", ["eth0", "eth0 is down"]),
            ("ip link set eth0 up", ["eth0", ""]),
            ("ip address delete 10.9.0.1/24 dev eth0", ["", "10.9.0.1 is no address of this machine any more"]),
            ("ip address add 10.9.0.1/24 dev eth0", ["eth0", ""]),
        ):
            here.run(*command.split())
            eventually(lambda told=told: listener.told[-1:] == [told], what=command)
        there.run("ip", "link", "set", "eth0", "down")
        eventually(lambda: listener.told[-1] == ["eth0", "eth0 has no carrier"], what="the carrier is lost")
    finally:
        listener.close()


def test_storm_of_changes_is_told_now_and_then(network: Network, tmp_path: Path) -> None:
    here = network.host("here")
    listener = _Listener(here, tmp_path / "told")
    try:
        changes = " ".join(f"10.9.1.{last}" for last in range(1, 101))
        adds = f"for each in {changes}; do ip address add $each/32 dev lo; done; ip address add 10.9.0.1/32 dev lo"
        here.run("sh", "-ec", f"date +%s.%N > {tmp_path / 'began'}; {adds}; date +%s.%N > {tmp_path / 'ended'}")
        began, ended = (float((tmp_path / name).read_text()) for name in ("began", "ended"))
        eventually(lambda: listener.told[-1:] == [["lo", ""]], what="the last change")
        assert len(listener.told) <= (ended - began) / 0.05 + 2
    finally:
        listener.close()


@pytest.mark.parametrize("transport", ["tcp", "zenoh"])
def test_roaming_robot_is_back_at_once(network: Network, tmp_path: Path, transport: str) -> None:
    with OutageBed(tmp_path, transport) as bed:
        record = bed.record(FAULTS["roam"])
    assert record.steady
    silences = []
    for flow in FLOWS:
        counts = count_topic(record, flow.name, flow.rate)
        assert flow.kind == "best" or not counts.lost, (flow, counts)
        assert (counts.doubled, counts.disordered) == (0, 0), (flow, counts)
        silences += [counts.silence] if flow.rate else []
    # By pings alone it takes 1.3 s, and on a quiet machine 0.2. What one topic waits for is no matter of the link.
    assert min(silences) < 1.2, silences


def test_lost_link_names_its_device(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    client = network.bridge(robot, pc, "10.99.1.1", EACH_WAY[1]).client
    robot.run("ip", "link", "set", "eth0", "down")
    client.happens(EventCode.LINK_LOST, "eth0 is down")
    eventually(lambda: "eth0 is down" in client.link()["reason"], what="attempts go on naming it")
    robot.run("ip", "link", "set", "eth0", "up")
    up = time.time()
    assert client.happens(EventCode.LINK_UP, since=up) < up + 10
