"""Recordings as files: what other programs read in them, and what is refused."""

from __future__ import annotations

import stat
import sys
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.records import SummaryOffset
from mcap.stream_reader import StreamReader
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability, QosHistory, QosReliability
from tests.engine.bytes_helpers import INSTALLED
from tests.support.filled import filled

from rsb_bridge.cdr.description import (
    DescriptionError,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    hash_of_text,
    text_of,
)
from rsb_bridge.config.files import UNFINISHED
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_extras.recording.mcap_file import McapError, RecordedTopic, new_recording
from rsb_extras.recording.message_definition import message_definition
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from pathlib import Path


def topic(type_name: str, name: str = "/topic", **changes: Any) -> RecordedTopic:
    text = installed(type_name)
    return RecordedTopic(name, type_name, hash_of_text(text), text, Qos())._replace(**changes)


def installed(type_name: str) -> str:
    text = installed_description(type_name)
    assert text is not None
    return text


def content(type_name: str) -> bytes:
    payload: bytes = serialize_message(filled(installed_class(type_name)))
    return payload


def test_rosbags_reads_each_field_of_all_types(tmp_path: Path) -> None:
    path, sent = tmp_path / "one.mcap", {type_name: content(type_name) for type_name in INSTALLED}
    with new_recording(path) as recording:
        for number, (type_name, payload) in enumerate(sent.items()):
            recording.add(topic(type_name, f"/topic{number}"), payload, number, number)
    with AnyReader([path]) as reader:
        assert {connection.msgtype: payload for connection, _, payload in reader.messages()} == sent
        for type_name, kind in INSTALLED.items():
            again = reader.typestore.serialize_cdr(reader.deserialize(sent[type_name], type_name), type_name)
            # Fillers between fields may differ.
            assert deserialize_message(bytes(again), kind) == filled(kind)
    assert len(read_strictly(path)) == len(INSTALLED)


def test_file_says_what_rosbag2_does(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    qos = Qos("best_effort", "transient_local", "keep_last", 7, deadline=0.5)
    recorded = topic("std_msgs/msg/String", "/chat", qos=qos, publisher="robot1")
    with new_recording(path) as recording:
        recording.add(recorded, content("std_msgs/msg/String"), 2_000, 1_000, 5)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    ((schema, channel, message),) = read_strictly(path)
    assert (schema.name, schema.encoding, schema.data) == ("std_msgs/msg/String", "ros2msg", b"string data\n")
    assert (channel.topic, channel.message_encoding) == ("/chat", "cdr")
    assert channel.metadata["topic_type_hash"] == recorded.type_hash
    assert channel.metadata["publisher"] == "robot1"
    assert (message.log_time, message.publish_time, message.sequence) == (2_000, 1_000, 5)
    (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert (profile["deadline"], profile["lifespan"]["sec"]) == ({"sec": 0, "nsec": 500_000_000}, 9223372036)
    with AnyReader([path]) as reader:
        (connection,) = reader.connections
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        (found,) = connection.ext.offered_qos_profiles
    assert (found.history, found.depth) == (QosHistory.KEEP_LAST, 7)
    assert (found.reliability, found.durability) == (QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL)


def test_topics_of_one_type_share_its_definition(tmp_path: Path) -> None:
    path, sent = tmp_path / "one.mcap", content("std_msgs/msg/String")
    with new_recording(path) as recording:
        for name in ("/one", "/two", "/one"):
            recording.add(topic("std_msgs/msg/String", name), sent, 1, 1)
    messages = read_strictly(path)
    assert len({schema.id for schema, _, _ in messages}) == 1
    assert [channel.topic for _, channel, _ in messages] == ["/one", "/two", "/one"]


@pytest.mark.parametrize("time", [-1, 0, 1 << 63, 1 << 80])
def test_times_of_any_clock_are_written(time: int, tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    with new_recording(path) as recording:
        recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), time, -time, 1 << 40)
    ((_, _, message),) = read_strictly(path)
    assert message.log_time == min(max(0, time), (1 << 64) - 1)


def test_message_is_published_before_it_is_logged(tmp_path: Path) -> None:
    """An estimate of when it was published on the other side may be some ms too late."""
    path = tmp_path / "one.mcap"
    with new_recording(path) as recording:
        for published in (900, 1_500):
            recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), 1_000, published)
    assert [message.publish_time for _, _, message in read_strictly(path)] == [900, 1_000]


def test_groups_of_the_summary_have_records(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    with new_recording(path) as recording:
        recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), 1, 1)
    with path.open("rb") as file:
        groups = [
            record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, SummaryOffset)
        ]
    assert {each.group_opcode for each in groups} == {
        Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX
    }  # fmt: skip
    assert all(each.group_length for each in groups)


def test_type_without_a_description_has_its_name(tmp_path: Path) -> None:
    """As rosbag2 writes it; the topics beside it are read."""
    path, sent = tmp_path / "one.mcap", content("std_msgs/msg/String")
    with new_recording(path) as recording:
        recording.add(RecordedTopic("/blob", "made_up_msgs/msg/Blob", "", "", Qos()), b"\0\1\0\0\1", 1, 1)
        recording.add(topic("std_msgs/msg/String"), sent, 2, 2)
    (schema, channel, message), _ = read_strictly(path)
    assert (schema.name, schema.encoding, schema.data) == ("made_up_msgs/msg/Blob", "", b"")
    assert (channel.topic, channel.message_encoding, message.data) == ("/blob", "cdr", b"\0\1\0\0\1")
    with AnyReader([path]) as reader:
        known = [connection for connection in reader.connections if connection.topic == "/topic"]
        assert [payload for _, _, payload in reader.messages(known)] == [sent]


def test_messages_without_fields_have_a_field() -> None:
    """Sections behind are not empty, either: test_msgs/msg/Arrays has a field of constants alone."""
    hidden = "uint8 structure_needs_at_least_one_member"
    assert message_definition(installed("std_msgs/msg/Empty")) == f"{hidden}\n"
    assert f"MSG: test_msgs/Constants\n{hidden}\n" in message_definition(installed("test_msgs/msg/Arrays"))
    assert message_definition(text_of(TypeDescription(MessageType("pkg/msg/Name", ()), ()))) == f"{hidden}\n"


@pytest.mark.parametrize(
    "type_name", ["test_msgs/msg/Arrays", "test_msgs/msg/UnboundedSequences", "test_msgs/msg/Nested"]
)
def test_types_with_constants_alone_are_read(type_name: str, tmp_path: Path) -> None:
    path, sent = tmp_path / "one.mcap", content(type_name)
    with new_recording(path) as recording:
        recording.add(topic(type_name), sent, 1, 1)
    with AnyReader([path]) as reader:
        ((connection, _, payload),) = reader.messages()
        again = reader.typestore.serialize_cdr(reader.deserialize(payload, connection.msgtype), connection.msgtype)
    kind = installed_class(type_name)
    assert deserialize_message(bytes(again), kind) == filled(kind)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    path.write_text("mine")
    with pytest.raises(FileExistsError), new_recording(path):
        pass
    assert path.read_text() == "mine"


def test_file_has_its_name_once_it_is_whole(tmp_path: Path) -> None:
    """Who kills the process meanwhile leaves nothing that a program takes for a recording."""
    path = tmp_path / "one.mcap"
    with new_recording(path) as recording:
        recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), 1, 1)
        (part,) = tmp_path.iterdir()
        assert part.suffix == UNFINISHED
        assert stat.S_IMODE(part.stat().st_mode) == 0o600
        with pytest.raises(FileExistsError), new_recording(path):
            pass
    assert [*tmp_path.iterdir()] == [path]
    assert len(read_strictly(path)) == 1


def test_half_a_recording_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"

    def half() -> None:
        with new_recording(path) as recording:
            recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), 1, 1)
            raise RuntimeError("the bridge stops")

    with pytest.raises(RuntimeError):
        half()
    assert not [*tmp_path.iterdir()]


def test_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(McapError, match=r"rsb-console\[record\]"), new_recording(tmp_path / "one.mcap"):
        pass
    assert not [*tmp_path.iterdir()]


def described(field: MessageField, name: str = "pkg/msg/Name", *others: MessageType) -> str:
    return text_of(TypeDescription(MessageType(name, (field,)), others))


STRING, NESTED, LONG_DOUBLE = FieldType(17, 0, 0, ""), FieldType(1, 0, 0, "pkg/msg/Other"), FieldType(12, 0, 0, "")


@pytest.mark.parametrize(
    "description",
    [
        "nonsense",
        described(MessageField("data\nMSG: std_msgs/String", STRING)),
        described(MessageField("", STRING)),
        described(MessageField("data", LONG_DOUBLE)),
        described(MessageField("data", FieldType(255, 0, 0, ""))),
        described(MessageField("data", FieldType(1, 0, 0, "=" * 80))),
        described(MessageField("data", NESTED), "pkg/msg/Name", MessageType("pkg/msg/Other\n", ())),
    ],
)
def test_hostile_description_defines_nothing(description: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError):
        message_definition(description)
    path = tmp_path / "one.mcap"
    with new_recording(path) as recording:
        with pytest.raises(DescriptionError):
            recording.add(RecordedTopic("/topic", "pkg/msg/Name", "", description, Qos()), b"", 1, 1)
        recording.add(topic("std_msgs/msg/String"), content("std_msgs/msg/String"), 1, 1)
    assert len(read(path)) == 1, "the others are written"


def test_types_in_types_follow() -> None:
    other = MessageType("pkg/msg/Other", (MessageField("numbers", FieldType(2 + 48, 3, 0, "")),))
    field = MessageField("others", FieldType(1 + 144, 0, 0, "pkg/msg/Other"))
    definition = message_definition(described(field, "pkg/msg/Name", other))
    assert definition == f"pkg/Other[] others\n{'=' * 80}\nMSG: pkg/Other\nint8[3] numbers\n"
