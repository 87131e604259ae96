"""A real engine remembers what happens to it, tells it to attached consoles, and goes on after a restart."""

from __future__ import annotations

import json
import threading
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import carries, linked
from tests.support.waiting import eventually

from rsb_bridge.engine import Engine
from rsb_bridge.model.session import Topic
from rsb_extras.history.history_data import ReportHistory

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain

    from rsb_extras.history.history_data import HistoryReport, Outage

pytest.importorskip("rclpy", reason="needs ROS 2")


def out(report: HistoryReport, topic: str = "") -> Outage | None:
    return next((each for each in report.outages if each.topic == topic), None)


def test_outage_of_real_link_is_remembered_and_kept(
    bridge: Bridge, robot: Domain, pc: Domain, machine: Machine, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    session = bridge.client_session(Topic("/tcp", "transmit", type="std_msgs/msg/String"))
    client = Engine(session, base=bridge.folder, state=state)
    server = bridge.server()
    client.start()
    try:
        machine.serve(client)
        remote = machine.attach()
        eventually(lambda: linked(client) and linked(server))
        heard, talker = pc.listener("/tcp"), robot.publisher("/tcp")
        carries([talker], server, ["/tcp"])
        eventually(lambda: remote.do(ReportHistory(60.0)).result(60).tracks)
        eventually(lambda: any(each.up > 1 for each in remote.do(ReportHistory(60.0)).result(60).tracks), what="up")
        server.stop()
        eventually(
            lambda: (found := out(remote.do(ReportHistory(60.0)).result(60))) and found.ongoing, what="the link is out"
        )
        bridge.server()
        eventually(lambda: linked(client))
        ended = eventually(
            lambda: found if (found := out(client.do(ReportHistory(60.0)).result(60))) and not found.ongoing else None
        )
        assert ended.cause
        assert ended.link == "robot1"
        assert heard
    finally:
        client.stop()
    eventually(lambda: "rsb-disk" not in [thread.name for thread in threading.enumerate()], what="its end")
    codes = [json.loads(line)["code"] for line in (state / "robot1.jsonl").read_text().splitlines()]
    assert codes[-1] == "engine.stopped"
    assert "link.up" in codes

    again = Engine(session, base=bridge.folder, state=state)
    again.start()
    try:
        kept = eventually(lambda: out(again.do(ReportHistory(3600.0)).result(60)))
        assert (kept.start, kept.cause) == (ended.start, ended.cause)
    finally:
        again.stop()
