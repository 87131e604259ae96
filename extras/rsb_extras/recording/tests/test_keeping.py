"""Recordings of bridges between two domains."""

from __future__ import annotations

import os
import resource
import stat
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from geometry_msgs.msg import PoseStamped
from msgspec.structs import replace
from nav_msgs.msg import OccupancyGrid, Odometry
from std_msgs.msg import String
from tests.support.bridge import carries, reloaded, stage
from tests.support.domain import LATCHED, text
from tests.support.filled import filled
from tests.support.inside import inside
from tests.support.participants import KnownNode
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import UNFINISHED, Shortage
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import Wish
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.keep_last import KeepLast
from rsb_extras.recording.keeping import FOLDER_SIZE, KeepProblem
from rsb_extras.recording.mcap_file import McapText
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_extras.recording.keep_last import KeptRecording
    from rsb_extras.recording.message_ring import MessageRing

ON = {"record": True}


def keep(engine: Engine, seconds: float | None = None) -> KeptRecording:
    return engine.do(KeepLast(seconds)).result(60)


def kept(engine: Engine) -> int:
    """Return the number of messages in an engine's ring."""
    part: Any = inside(engine).handlers[KeepLast]
    ring = part.__self__.ring
    return 0 if ring is None else len(ring)


def halves(engine: Engine) -> list[Sender | Receiver]:
    found = [route.half for link in inside(engine).role.links() for route in tuple(link.routes.values())]
    return [half for half in found if isinstance(half, Sender | Receiver)]


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
                # By the measured latency, which may be some ms too long.
                assert began - 1e9 <= message.publish_time <= time.time_ns()
                assert abs(message.log_time - message.publish_time) < 30e9
    assert len([*folder.glob("*.mcap")]) == 2, "nothing is overwritten"


def test_topic_of_a_type_that_nobody_describes_is_written(bridge: Bridge) -> None:
    robot, pc = KnownNode(bridge.robot.id, "sends"), KnownNode(bridge.pc.id, "hears")
    for node in (robot, pc):
        node.start()
    try:
        spec = TopicSpec("/blob", "made_up_msgs/msg/Blob", f"RIHS01_{'5a' * 32}", Qos(depth=20))
        publisher, received = robot.advertise(spec, "robot"), list[bytes]()
        pc.subscribe(spec, lambda batch: received.extend(each.payload for each in batch), "pc")
        server, client = bridge.both(Topic("/blob", "transmit"), features=ON)
        payload = b"\0\1\0\0\7"

        def is_heard() -> bool:
            publisher.publish(payload)
            return bool(received)

        eventually(is_heard)
        for engine in (server, client):
            written = keep(engine)
            assert written.undescribed == ("/blob",)
            schema, channel, message = read_strictly(written.path)[0]
            assert (schema.name, schema.encoding, channel.topic) == (spec.type_name, "", "/blob")
            assert message.data == payload
    finally:
        for node in (robot, pc):
            node.stop()


def test_off_no_route_has_a_tap(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    engines = bridge.both(Topic("/chat", "transmit"))
    carries([publisher], engines[0], ["/chat"])
    publisher.publish(text("one"))
    eventually(lambda: listener.payloads)
    for engine in engines:
        (half,) = halves(engine)
        assert half.flow.peek_slot.tap is None
        assert not half.flow.peek_slot.wanted
        with pytest.raises(EngineError, match=pattern(KeepProblem.OFF)):
            keep(engine)


@pytest.mark.parametrize("side", ["here", "there"])
def test_what_is_recorded_does_not_rest(side: str, bridge: Bridge, robot: Domain) -> None:
    publisher = robot.publisher("/chat")
    bridge.server(features=ON if side == "there" else {})
    bridge.client(Topic("/chat", "transmit", lazy=True), features=ON if side == "here" else {})
    eventually(publisher.get_subscription_count)


def test_burst_of_large_and_small_keeps_order(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Large ones are unpacked and published on other threads; those behind them wait."""
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    engines = bridge.both(Topic("/chat", "transmit", compression="zstd"), features=ON)
    carries([publisher], engines[0], ["/chat"])
    words = [f"{number} " * (400_000 if number % 10 == 0 else 1) for number in range(50)]
    for each in words:
        publisher.publish(text(each))
    eventually(lambda: len(listener.payloads) == 50)
    for engine in engines:
        eventually(lambda engine=engine: kept(engine) == 50)
        assert [each.message.data for each in read(keep(engine).path)] == words


def test_latched_topic_from_before_the_window_is_there(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    pc.listener("/map", OccupancyGrid, LATCHED)
    chat, there = robot.publisher("/chat"), pc.listener("/chat")
    robot.publisher("/map", OccupancyGrid, LATCHED).publish(OccupancyGrid(data=[7]))
    topics = Topic("/map", "transmit"), Topic("/chat", "transmit")
    engines = bridge.both(*topics, features={"record": RecordLimits(seconds=1.0, megabytes=1.0)})
    eventually(lambda: stage(engines[0], "/map", "published"))
    carries([chat], engines[0], ["/chat"])
    began = time.time()
    eventually(lambda: time.time() - began > 1.5)

    def ends(engine: Engine) -> tuple[Any, Any] | None:
        """Return the first and the last message; on a busy machine, the last may be too old before it is kept."""
        came = len(there.payloads)
        chat.publish(text("late"))
        eventually(lambda: len(there.payloads) > came)
        found = read(keep(engine).path)
        return (found[0], found[-1]) if len(found) > 1 else None

    for engine in engines:
        first, second = eventually(lambda engine=engine: ends(engine))
        assert (first.topic, second.topic, first.message.data.tolist()) == ("/map", "/chat", [7])
        assert second.time - first.time < 1e9, "players do not wait for the others"


def test_recording_begins_and_ends_with_a_reload(bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path) -> None:
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([publisher], server, ["/chat"])
    publisher.publish(text("before"))
    eventually(lambda: listener.payloads)
    for engine in (server, client):
        reloaded(engine, tmp_path / f"{engine.session.role}.yaml", features=ON)
    publisher.publish(text("between"))
    for engine in (server, client):
        eventually(lambda engine=engine: kept(engine) == 1)
        assert [each.message.data for each in read(keep(engine).path)] == ["between"]
        reloaded(engine, tmp_path / f"{engine.session.role}.yaml", features={})
        assert (kept(engine), halves(engine)[0].flow.peek_slot.tap) == (0, None)
    publisher.publish(text("after"))
    eventually(lambda: len(listener.payloads) == 3)
    with pytest.raises(EngineError, match=pattern(KeepProblem.OFF)):
        keep(client)


def test_message_over_several_links_is_kept_once(bridge: Bridge, robot: Domain, pc: Domain, third: Domain) -> None:
    """The server takes it from one robot, and brings it to another; it takes the PC's own to both."""
    clients = tuple(Client(name, key_file=bridge.key_file) for name in ("from", "to"))
    server = bridge.server(clients=clients, shared_keys=True, features=ON)
    bridge.client(Topic("/chat", "transmit"), Topic("/news", "receive"), name="from")
    bridge.client(Topic("/chat", "receive"), Topic("/news", "receive"), name="to", domain_id=third.id)
    chat, news = robot.publisher("/chat"), pc.publisher("/news")
    listeners = [third.listener("/chat"), third.listener("/news"), robot.listener("/news")]
    pc.listener("/chat")

    def is_heard() -> bool:
        chat.publish(text("first"))
        news.publish(text("first"))
        return all(each.payloads for each in listeners)

    eventually(is_heard)
    for number in range(10):
        chat.publish(text(f"chat {number}"))
        news.publish(text(f"news {number}"))
    eventually(lambda: all(each.texts(1)[0].endswith(" 9") for each in listeners))
    words = sorted(each.message.data for each in read(keep(server).path) if each.message.data != "first")
    assert words == sorted(f"{topic} {number}" for topic in ("chat", "news") for number in range(10))


def test_topic_of_a_view_is_recorded_where_it_is_drawn(bridge: Bridge, robot: Domain) -> None:
    publisher = robot.publisher("/pose", PoseStamped)
    server, client = bridge.both(features=ON)
    eventually(lambda: inside(client).context.ros.publishers("/pose"))
    look = LookAtTopics("me", ("/pose",), Wish(40, 20))

    def drawn() -> bool:
        publisher.publish(PoseStamped())
        return server.do(look).result(30) is not None and kept(client) > 2

    eventually(drawn)
    assert {each.topic for each in read(keep(client).path)} == {"/pose"}
    with pytest.raises(EngineError, match=pattern(KeepProblem.NOTHING_YET)):
        keep(server)
    server.do(EndLook("me")).result(30)


@pytest.fixture
def talking(bridge: Bridge, robot: Domain, pc: Domain) -> Engine:
    """A client that has kept a message."""
    publisher = robot.publisher("/chat")
    pc.listener("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"), features=ON)
    carries([publisher], server, ["/chat"])
    publisher.publish(text("one"))
    eventually(lambda: kept(client) == 1)
    return client


def test_full_disk_is_a_plain_error(talking: Engine, folder: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with pytest.raises(EngineError, match=pattern(Shortage.FILE_SIZE, error="File too large")):
            keep(talking)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not [*folder.iterdir()]
    assert keep(talking).messages == 1


def test_recordings_fill_no_disk(talking: Engine, folder: Path) -> None:
    keep(talking)
    with (folder / "many.mcap").open("wb") as file:
        file.truncate(FOLDER_SIZE)
    with pytest.raises(EngineError, match=pattern(KeepProblem.FOLDER_FULL, folder=folder, size=2.1)):
        keep(talking)


def test_what_killed_bridges_left_is_removed(talking: Engine, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    left, fresh = (folder / f".{name}.mcap{UNFINISHED}" for name in ("left", "fresh"))
    for part in (left, fresh):
        part.write_bytes(bytes(100))
    os.utime(left, (0.0, 0.0))
    stretch = folder / f".robot1-1700000000000{UNFINISHED}"  # of the ring on disk, whose bridge is away
    stretch.mkdir()
    os.utime(stretch, (0.0, 0.0))
    keep(talking)
    assert stretch.exists()
    assert not left.exists()
    assert fresh.exists()  # another bridge may be about to write it
    with fresh.open("r+b") as file:
        file.truncate(FOLDER_SIZE)
    with pytest.raises(EngineError, match=pattern(KeepProblem.FOLDER_FULL, folder=folder, size=2.1)):
        keep(talking)


def test_file_that_another_bridge_finishes_meanwhile_is_no_obstacle(talking: Engine, folder: Path) -> None:
    """A link to nothing is listed, and is gone when it is asked for, as such a file is."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f".gone.mcap{UNFINISHED}").symlink_to(folder / "nothing")
    assert keep(talking).messages == 1


def test_one_recording_is_written_at_a_time(talking: Engine) -> None:
    futures = [talking.do(KeepLast()) for _ in range(3)]
    texts = [str(future.exception(60) or "") for future in futures]
    assert texts == ["", KeepProblem.BUSY(), KeepProblem.BUSY()]


def test_missing_library_is_named_by_the_engine(talking: Engine, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mcap.writer", None)
        with pytest.raises(EngineError, match=pattern(McapText.NOT_INSTALLED)):
            keep(talking)
    assert not [*folder.iterdir()]


def test_loop_sees_the_file_grow_while_a_recording_is_written(talking: Engine, folder: Path) -> None:
    """Of a ring that is full of small messages, which take longest to write."""
    part: Any = inside(talking).handlers[KeepLast]
    ring: MessageRing = part.__self__.ring
    newest = ring.copy(0.0)[1][0]
    sizes: set[int] = set()
    full = threading.Event()

    def fill() -> None:
        now = inside(talking).context.now()
        while ring.held + 2 * newest.cost < ring.size:
            ring.add(replace(newest, at=now))
        full.set()
        turn()

    def turn() -> None:
        with suppress(FileNotFoundError):  # it has just got its name
            sizes.update(each.stat().st_size for each in folder.iterdir())
        inside(talking).context.loop.call_later(0.001, turn)

    inside(talking).context.call(fill)
    assert full.wait(60)
    written = keep(talking)
    assert written.messages > 100_000
    assert len(sizes) > 5, sizes
