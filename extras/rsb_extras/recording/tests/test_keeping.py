"""Recordings of bridges between two domains."""

from __future__ import annotations

import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from nav_msgs.msg import OccupancyGrid, Odometry
from std_msgs.msg import String
from tests.support.bridge import carries, stage
from tests.support.domain import LATCHED, text
from tests.support.filled import filled
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.model.session import Topic
from rsb_bridge.route.topic_route import TopicRoute
from rsb_extras.recording.keep_last import KeepLast
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_extras.recording.keep_last import KeptRecording

ON = {"record": True}


def keep(engine: Engine, seconds: float | None = None) -> KeptRecording:
    return engine.do(KeepLast(seconds)).result(60)


def kept(engine: Engine) -> int:
    """Return the number of messages in an engine's ring."""
    part: Any = inside(engine).handlers[KeepLast]
    ring = part.__self__.ring
    return 0 if ring is None else len(ring)


def routes(engine: Engine) -> list[TopicRoute[Any]]:
    found = [route for link in inside(engine).role.links() for route in tuple(link.routes.values())]
    return [route for route in found if isinstance(route, TopicRoute)]


def test_both_sides_write_what_passed(bridge: Bridge, robot: Domain, pc: Domain, folder: Path) -> None:
    grid = OccupancyGrid()
    grid.info.width, grid.info.height, grid.data = 3, 2, [0, 100, -1, 0, 0, 0]
    robot.publisher("/map", OccupancyGrid, LATCHED).publish(grid)
    chat, odometry = robot.publisher("/chat"), robot.publisher("/odom", Odometry)
    for topic, kind in (("/chat", String), ("/odom", Odometry)):
        pc.listener(topic, kind)
    pc.listener("/map", OccupancyGrid, LATCHED)
    topics = (Topic("/chat", "transmit"), Topic("/odom", "transmit", compression="zstd"), Topic("/map", "transmit"))
    engines = bridge.both(*topics, features=ON)
    carries([chat, odometry], engines[0], ["/chat", "/odom"])
    eventually(lambda: stage(engines[0], "/map", "published"))
    began = time.time_ns()
    for number in range(20):
        chat.publish(text(f"message {number}"))
        odometry.publish(filled(Odometry))
    eventually(lambda: all(kept(each) == 41 for each in engines))
    for engine in engines:
        written = keep(engine)
        path = Path(written.path)
        assert (written.messages, written.topics, path.parent) == (41, 3, folder)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        messages = read(path)
        times = [each.time for each in messages]
        assert times == sorted(times)
        assert [each.message.data for each in messages if each.topic == "/chat"] == [f"message {n}" for n in range(20)]
        assert {each.message.child_frame_id for each in messages if each.topic == "/odom"} == {"größer"}
        (latched,) = (each.message for each in messages if each.topic == "/map")
        assert (latched.info.width, latched.data.tolist()) == (3, [0, 100, -1, 0, 0, 0])
        for schema, channel, message in read_strictly(path):
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            if channel.topic == "/chat":
                assert began <= message.publish_time <= time.time_ns()
                assert abs(message.log_time - message.publish_time) < 30e9
    first, second = folder.glob("*.mcap")
    assert first != second


def test_off_no_route_has_a_tap(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    engines = bridge.both(Topic("/chat", "transmit"))
    carries([publisher], engines[0], ["/chat"])
    publisher.publish(text("one"))
    eventually(lambda: listener.payloads)
    for engine in engines:
        (route,) = routes(engine)
        assert route.peek_slot.tap is None
        assert not route.peek_slot.wanted
        with pytest.raises(EngineError, match="record: true"):
            keep(engine)
