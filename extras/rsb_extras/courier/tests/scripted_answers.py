"""The recordings of the robot that `tests.console.scripted` plays."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from rsb_extras.courier.completed_recording import (
    ClockSource,
    CompletedClock,
    CompletedRecording,
    CompletedTopic,
    MissingReason,
    MissingSpan,
)
from rsb_extras.courier.courier_records import ListedRecording, ListedTopic
from rsb_extras.courier.courier_requests import (
    CancelFetch,
    FetchRecording,
    FetchReport,
    FetchState,
    ListFetches,
    ListRecordings,
    NewestRecordings,
    ReadCompleted,
    RecordingGroup,
)

BEGAN = 1_785_406_500_000_000_000
DRIVE = ListedRecording(
    "0123456789abcdef", "fault-101500", "fedcba9876543210", 184_000_000, BEGAN,
    BEGAN + 90_000_000_000, 18_000,
    (ListedTopic("/scan", "sensor_msgs/msg/LaserScan", 900), ListedTopic("/tf", "tf2_msgs/msg/TFMessage", 17_100)),
    cause="fault", note="/scan stopped",
)  # fmt: skip
GROUPS = (
    RecordingGroup("", (ListedRecording("0" * 16, "noon.mcap", "1" * 16, 8_400_000, BEGAN, BEGAN),)),
    RecordingGroup("robot1", (DRIVE,)),
)
FETCH = FetchReport(
    "robot1-drive", "robot1", DRIVE.name, FetchState.FETCHING, 0.25, 42_000_000, 1_500_000.0, 84.0
)  # fmt: skip
DONE = FetchReport(
    "robot1-run7", "robot1", "run7", FetchState.DONE, 1.0, 184_000_000, 0.0, 0.0, 18_000,
    "/var/lib/rsb-console/recordings/fetched/robot1-run7.mcap",
)  # fmt: skip


COMPLETED = CompletedRecording(
    CompletedClock(ClockSource.MESSAGES, -1_500_000_000, 900, 2_000_000),
    (CompletedTopic(
        "/scan", "/front/scan", 900, 10, 80, 12,
        (
            MissingSpan(MissingReason.LOST, BEGAN, BEGAN + 1_000_000_000, 12),
            MissingSpan(MissingReason.BEGINS_LATER, 0, 0),
        ), 3,
    ),),
    1_000_000, 9_000_000,
)  # fmt: skip


def _listed(command: ListRecordings) -> Any:
    groups = GROUPS[:1] if command.here else GROUPS[1:] if command.there else GROUPS
    return tuple(group for group in groups if command.link in ("", group.link))


def _newest(_: NewestRecordings) -> Any:
    return GROUPS[0], replace(GROUPS[1], recordings=(replace(DRIVE, topics=()),), age=200.0)


ANSWERS: dict[Any, Any] = {
    ListRecordings: _listed,
    NewestRecordings: _newest,
    FetchRecording: lambda _: DONE.name,
    ListFetches: lambda _: (FETCH, DONE),
    ReadCompleted: lambda _: COMPLETED,
    CancelFetch: lambda _: None,
}
