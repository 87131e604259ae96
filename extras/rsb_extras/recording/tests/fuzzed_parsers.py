"""A recording to read by its index: from anywhere, cut off, damaged, or made to do harm."""

from __future__ import annotations

from contextlib import suppress

from mcap.writer import CompressionType
from tests.fuzz.parser import Parser
from tests.fuzz.scratch import scratch_folder

from rsb_extras.audit.tests.fuzzed_parsers import small_bag, small_mcap
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import RecordingError

_PART = 10**18 + 2


def _read_recording(data: bytes) -> None:
    path = scratch_folder() / "opened.mcap"
    path.write_bytes(data)
    with suppress(RecordingError):
        recording = OpenRecording(path)
        times = []
        for message in recording.messages():
            times.append(message.time)
            assert message.channel in recording.channels
        assert times == sorted(times)
        found = [each.time for each in recording.messages(begin=_PART, topics={"/scan"})]
        assert all(time >= _PART for time in found)
        assert len(found) <= len(times)


_SEEDS = (
    small_bag(),
    small_mcap(CompressionType.NONE, True),
    small_mcap(CompressionType.NONE, False),
    small_mcap(CompressionType.LZ4, True),
)
PARSERS = (Parser("opened_recording", _read_recording, _SEEDS),)
