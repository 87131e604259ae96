"""The rings of two bridges between two domains, with outages between them: what nodes published is in one file."""

from __future__ import annotations

import time
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, String
from tests.support.bridge import carries, linked
from tests.support.domain import LATCHED, text
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_extras.audit.comparing import AuditOptions, compare
from rsb_extras.courier.completed_recording import ClockSource
from rsb_extras.courier.courier_requests import FetchRecording
from rsb_extras.courier.tests.courier_bed import done, robot_features
from rsb_extras.disk_ring.keep_stretch import KeepStretch
from rsb_extras.disk_ring.tests.ring_bed import written_so_far
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

LOSSY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RING: dict[str, Any] = {"record": RecordLimits(disk=1.0, free=0.0, after=0.0)}


def in_rings(state: Path, words: bytes) -> int:
    """How many bridges' rings have these words on disk."""
    return sum(
        any(words in written_so_far(each) for each in folder.glob("*.mcap")) for folder in (state / "ring").glob("*/")
    )


def test_what_an_outage_lost_is_completed(
    bridge: Bridge, robot: Domain, pc: Domain, relay: Relay, bags: Path, fetched: Path
) -> None:
    chat, beat = robot.publisher("/chat", qos=LOSSY), robot.publisher("/beat", Bool)
    pc.listener("/robot1/chat", qos=LOSSY)
    pc.listener("/beat", Bool)
    pc.listener("/map", String, LATCHED)
    robot.publisher("/map", String, LATCHED).publish(text("the map"))
    server = bridge.server(features=RING)
    client = bridge.client(
        Topic("/chat", "transmit", remote_topic="/robot1/chat", max_age=1.0),
        Topic("/beat", "transmit"),
        Topic("/map", "transmit"),
        features=RING | robot_features(bags),
    )
    carries([chat, beat], server, ["/robot1/chat", "/beat"])
    state, sent, numbers = fetched.parents[1], list[str](), count()

    def publish(times: int) -> None:
        for _ in range(times):
            sent.append(f"word {next(numbers)} {'.' * 200}")
            chat.publish(text(sent[-1]))
            beat.publish(Bool(data=True))

    def both_have_some() -> bool:
        return any(in_rings(state, each.encode()) == 2 for each in sent[-20:])

    def robot_has_all(since: float = 0.0) -> bool:
        return in_rings(state, sent[-1].encode()) > 0 and time.monotonic() - since > 1.2

    for _ in range(3):
        publish(20)
        eventually(both_have_some, what="both sides have some of it")
        relay.refuse()
        relay.cut()
        eventually(lambda: not linked(client), what="an outage")
        publish(60)
        eventually(partial(robot_has_all, time.monotonic()), what="it is recorded, and too old")
        relay.refuse(False)
        eventually(lambda: linked(client) and linked(server), 120, "linked")
        carries([chat, beat], server, ["/robot1/chat", "/beat"])
    publish(20)
    eventually(both_have_some, what="both sides have some of it")
    eventually(robot_has_all, what="it is recorded")
    stretch = Path(client.do(KeepStretch()).result(60).path)
    eventually(stretch.is_dir, what="the stretch is whole")

    asked = FetchRecording("robot1", stretch.name, ("/chat", "/beat", "/map"), completes=True)
    found = done(server, server.do(asked).result(60))
    assert found.completed is not None
    topics = {each.name: each for each in found.completed.topics}
    assert found.completed.clock.source is ClockSource.MESSAGES
    assert {(name, each.missing, each.only_live) for name, each in topics.items()} == {
        ("/robot1/chat", 0, 0), ("/beat", 0, 0), ("/map", 0, 0),
    }  # fmt: skip
    assert topics["/robot1/chat"].fetched > 100
    assert (topics["/map"].live, topics["/map"].fetched) == (1, 0)
    made = read(found.path)
    assert [each.message.data for each in made if each.topic == "/robot1/chat"] == sent
    assert sum(each.topic == "/beat" for each in made) == len(sent)
    assert [each.message.data for each in made if each.topic == "/map"] == ["the map"]
    assert [each.time for each in made] == sorted(each.time for each in made)
    strictly = read_strictly(found.path)
    assert [
        deserialize_message(each.data, String).data for _, channel, each in strictly if "chat" in channel.topic
    ] == sent
    kept = {each.channel.topic: each.channel for each in OpenRecording(Path(found.path)).messages()}
    assert "transient_local" in kept["/map"].profiles

    report = compare(stretch, Path(found.path), AuditOptions(pairs=[("/chat", "/robot1/chat")]))
    assert not report.breaches, report.breaches
    assert len(report.topics) == 3
