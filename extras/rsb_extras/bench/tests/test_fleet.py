"""A small fleet from end to end: real bridges, a stand-in for the robots' ROS, a control side with real ROS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bench.fleet import Plan, measure
from tests.support.waiting import eventually

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import read_description
from rsb_bridge.cdr.known_types import BATTERY_STATE, STRING, STRING_HASH
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RawMessage, TopicSpec
from rsb_extras.demo.stand_in import StandIn, Talk
from rsb_extras.fleet.simulated_fleet import USUAL

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).parents[4]
WITHIN = 180.0


def test_fleet_links_flows_comes_back_and_bears_flood(spare_domains: int) -> None:
    found = measure(3, domain=spare_domains, plan=Plan(settles=0.0, watched=1.0, down=0.7))
    assert found.routes == 3 * USUAL.routes
    assert 0 < found.linked.half <= found.linked.last <= found.flowing.last
    assert 0 < found.again.half <= found.again.last <= found.again_flowing.last
    assert sum(found.attempts) > 3  # each comes back, and at least one attempt has failed: nobody listened
    assert found.refused == 0
    assert found.steady.lost == Counter()
    assert found.steady.control > 0
    assert len(found.told) == len(USUAL.talks)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_of_bench_that_is_ended_runs_on(number: signal.Signals, tmp_path: Path, spare_domains: int) -> None:
    command = [sys.executable, "-m", "bench.fleet", "--robots", "2", "--domain", str(spare_domains)]
    bench = subprocess.Popen(command, cwd=ROOT, env=os.environ | {"TMPDIR": str(tmp_path)}, stdout=subprocess.DEVNULL)
    try:
        # The control side and the robots; their nodes do not name the folder.
        eventually(lambda: len(processes_of(tmp_path)) == 3, WITHIN, "control side and robots")
    finally:
        bench.send_signal(number)
        bench.wait(WITHIN)
    eventually(lambda: not processes_of(tmp_path), WITHIN, "the end of all processes")
    if number is signal.SIGTERM:
        assert [*tmp_path.iterdir()] == []


def processes_of(folder: Path) -> list[str]:
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_text().split("\0")
        except OSError:
            continue
        if any(word.startswith(str(folder)) for word in words):
            found.append(process.name)
    return found


def test_battery_of_stand_in_loses_charge() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import BatteryState

    from rsb_bridge.ros.native.typesupport import hash_of

    talk = Talk("/battery_state", 1.0, 0, BATTERY_STATE)
    ros, other = StandIn("robot1", [talk]), StandIn("robot2", [talk])
    assert (ros.topics(), ros.publishers(talk.topic)[0].type_hash) == (
        {talk.topic: [BATTERY_STATE]},
        hash_of(BatteryState),
    )
    description = ros.installed_description(BATTERY_STATE)
    assert description is not None
    taken: list[RawMessage] = []
    for each in (ros, other):
        each.subscribe(TopicSpec(talk.topic, BATTERY_STATE, hash_of(BatteryState), Qos()), taken.extend, "")
    ros.publish(talk.topic, 0, 2)
    other.publish(talk.topic, 0)
    first, second, others = (deserialize_message(each.payload, BatteryState).percentage for each in taken)
    assert 0 < second <= first <= 1
    assert others != pytest.approx(first, abs=0.01)
    read = decode(read_description(description, hash_of(BatteryState)), taken[0].payload, items=0)
    assert read.message["percentage"] == first


def test_stand_in_carries_what_node_publishes_and_hears() -> None:
    ros = StandIn("robot1", [Talk("/scan", 5.0, 100)], ["/goal"])
    assert (len(ros.publishers("/scan")), len(ros.publishers("/goal"))) == (1, 0)
    assert (len(ros.subscriptions("/scan")), len(ros.subscriptions("/goal"))) == (0, 1)
    taken: list[Sequence[RawMessage]] = []
    ros.publish("/scan", 100)
    subscription = ros.subscribe(TopicSpec("/scan", STRING, STRING_HASH, Qos()), taken.append, "")
    ros.publish("/scan", 100, 2)
    subscription.close()
    subscription.close()
    ros.publish("/scan", 100)
    assert [[each.number for each in batch] for batch in taken] == [[2, 3]]
    assert {each.gid for batch in taken for each in batch} == {ros.publishers("/scan")[0].gid}
    ros.muted.add("/scan")
    ros.publish("/scan", 100)
    assert ros.published == {"/scan": 4}
    goal, other = (ros.advertise(TopicSpec(topic, STRING, STRING_HASH, Qos()), "") for topic in ("/goal", "/map"))
    assert (goal.subscriber_count, other.subscriber_count) == (1, 0)
    goal.publish(b"")
    other.publish(b"")
    assert ros.received == {"/goal": 1}
