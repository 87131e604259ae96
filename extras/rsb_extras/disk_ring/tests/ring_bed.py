"""A ring on disk without a bridge: the test gives it messages, and sets its clock."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from tests.support.domain import text

from rsb_bridge.cdr.description import hash_of_text
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.disk_ring.ring_files import RingClocks, RingFiles, RingPlace
from rsb_extras.disk_ring.segments import complete
from rsb_extras.disk_ring.stretches import Occasion
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.latched_messages import LatchedMessages
from rsb_extras.recording.mcap_file import RecordedTopic
from rsb_extras.recording.message_ring import RingMessage
from rsb_extras.recording.tests.recordings import read_strictly

if TYPE_CHECKING:
    from rsb_extras.disk_ring.stretches import Reason

STRING = "std_msgs/msg/String"
LATCHED = Qos(durability="transient_local")
_WALL = 1_700_000_000.0  # s since the epoch, when the bed's clock is 0
SMALL = RecordLimits(disk=1.0, free=0.0)


def spec(name: str, qos: Qos | None = None, type_name: str = STRING) -> TopicSpec:
    description = installed_description(type_name)
    assert description is not None
    return TopicSpec(name, type_name, hash_of_text(description), qos or Qos())


CHAT, FRAMES = spec("/chat"), spec("/tf_static", LATCHED)


def recorded(topic: TopicSpec) -> RecordedTopic:
    description = installed_description(topic.type_name)
    assert description is not None
    return RecordedTopic(topic.topic, topic.type_name, topic.type_hash, description, topic.qos)


def message(
    at: float, content: str, topic: TopicSpec = CHAT, publisher: bytes = b"one", number: int = 1
) -> RingMessage:
    """A String that passes at a time of the bed's clock (s)."""
    time = int((_WALL + at) * 1e9)
    return RingMessage(at, topic, text(content), time, time, 1, publisher)


class RingBed:
    """A ring, and a clock that stands still until a test sets it.

    Attributes:
        now: s of the steady clock; the wall clock follows.
    """

    def __init__(self, state: Path, limits: RecordLimits = SMALL, now: float = 1000.0) -> None:
        self.now = now
        self.state = state
        self.events = EventLog(Clock())
        self.described: dict[TopicSpec, RecordedTopic] = {}
        clocks = RingClocks(lambda: self.now, lambda: self.wall)
        place = RingPlace(state, "robot1", "client")
        self.files = RingFiles(place, limits, clocks, self.events, self.described, LatchedMessages())
        self._is_closed = False
        self.files.begin()

    @property
    def wall(self) -> float:
        return _WALL + self.now

    @property
    def segments(self) -> list[Path]:
        return sorted(self.files.folder.glob("*.mcap"))

    @property
    def stretches(self) -> list[Path]:
        return sorted(each for each in (self.state / "recordings").glob("*") if not each.name.startswith("."))

    def codes(self) -> list[str]:
        return [each.code for each in self.events.after(0)]

    def write(self, *contents: str, topic: TopicSpec = CHAT, publisher: bytes = b"one") -> None:
        """Write messages that pass now."""
        self.described.setdefault(topic, recorded(topic))
        for each in contents:
            self.files.write(self.described[topic], message(self.now, each, topic, publisher))

    def pass_time(self, seconds: float) -> None:
        """Let time pass, a second at a time, with a message in each."""
        for _ in range(int(seconds)):
            self.now += 1.0
            self.write(f"at {self.now:g}")
            self.files.look_after(0)

    def keep(self, reason: Reason = "fault", note: str = "") -> Path | str:
        return self.files.keep(Occasion(self.now, self.wall, reason, note, "/chat"), 0)

    def end(self) -> None:
        """End as a bridge that stops does."""
        self.files.end(0)
        self.close()

    def close(self) -> None:
        """End as a bridge that is killed does. May be called twice."""
        if not self._is_closed:
            self._is_closed = True
            self.files.close()


def texts(path: Path, topic: str = "/chat") -> list[str]:
    """Read the Strings of a segment, or of a folder of them, in order."""
    files = sorted(path.glob("*.mcap"), key=lambda each: int(each.stem.rpartition("_")[2])) if path.is_dir() else [path]
    return [
        deserialize_message(found.data, String).data
        for file in files
        for _, channel, found in read_strictly(file)
        if channel.topic == topic
    ]


def written_so_far(segment: Path) -> bytes:
    """Read the messages of a segment whose end is not written yet, one behind the other."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / segment.name
        shutil.copy(segment, copy)
        return b"".join(found.data for _, _, found in read_strictly(copy)) if complete(copy).messages else b""


def metadata(stretch: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((stretch / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return found
