"""The two recordings of a benchmark on one machine: what the talker published, and what the listener heard.

While it measures, each run's messages wait in files of a few bytes a message (`kept_messages`); the recordings are
written when all is measured, as writing them would disturb it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, text_of
from rsb_bridge.cdr.known_types import STRING, STRING_HASH
from rsb_bridge.feature_api import Qos, Wording
from rsb_extras.bench.kept_messages import read_kept
from rsb_extras.recording.mcap_file import RecordedTopic, new_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from rsb_extras.bench.results import BenchReport, Point, Run
    from rsb_extras.recording.mcap_file import McapFile

MOST_BYTES = 4 << 30
"""Bytes of the messages in one recording. The file is far smaller, but writing both takes 7 s then, and readers unpack
all of it."""
_STRING_TYPE = 17  # type_description_interfaces/msg/FieldType
_DESCRIPTION = text_of(
    TypeDescription(MessageType(STRING, (MessageField("data", FieldType(_STRING_TYPE, 0, 0, "")),)), ())
)


class RecordingText(Wording):
    NOT_KEPT = "{count} of {runs} runs are not in the recordings: too many messages, or altered ones"
    INCOMPLETE = (
        "{count} of {runs} runs, the largest, are not in the recordings, which have room for {gigabytes:.1f} GB of "
        "messages: give smaller --sizes"
    )


class KeptRun(NamedTuple):
    """Where the messages of a run wait.

    Attributes:
        topic: its topic in the recordings.
        near: file of what the talker published.
        far: file of what the listener heard.
        depth: that of both ends' QoS.
    """

    topic: str
    near: Path
    far: Path
    depth: int


class BenchRecording:
    """Records each run of a report as one topic. The runs of a search that the report leaves out are not recorded.

    Args:
        near: path of the talker's recording, where nothing is yet.
        far: path of the listener's recording, where nothing is yet.
        folder: for the kept messages; it has to exist until `write` has returned.
        epoch: the wall clock less the monotonic clock, in ns. One number for all messages: the difference of two times
            in the recordings is then as it was measured, also if somebody sets the wall clock meanwhile.
    """

    def __init__(self, near: Path, far: Path, folder: Path, report: BenchReport, epoch: int) -> None:
        self._near, self._far = near, far
        self._folder = folder
        self._report = report
        self._epoch = epoch
        self._kept: dict[str, KeptRun] = {}
        self._names: Counter[str] = Counter()

    def keep(self, name: str, depth: int) -> KeptRun:
        """Return where the messages of the next run are to wait.

        Args:
            name: of the topic; if a run has it already, this one gets a number, too.
        """
        self._names[name] += 1
        topic = name if self._names[name] == 1 else f"{name}_{self._names[name]}"
        near, far = (self._folder / f"{len(self._kept)}-{side}" for side in ("near", "far"))
        kept = self._kept[topic] = KeptRun(topic, near, far, depth)
        return kept

    def write(self, say: Callable[[str], None]) -> None:
        """Write both recordings, or none if no run is recorded. The report then tells what is in them.

        Args:
            say: progress callback.

        Raises:
            McapError: MCAP's library is not installed.
            OSError: a file is there, or it cannot be written; then the listener's may be there alone.
        """
        # A run may be the best one and that for the latency, too; only the former's bytes on the wire are counted.
        points = self._report.points
        runs = list(dict.fromkeys(replace(run, wire=None) for point in points for run in point.runs))
        kept = [run for run in runs if run.topic]
        topics = _smallest(kept)
        self._report.points = [_recorded(point, set()) for point in points]
        if len(kept) < len(runs):
            self._report.notes.append(RecordingText.NOT_KEPT(count=len(runs) - len(kept), runs=len(runs)))
        if len(topics) < len(kept):
            figures = {"count": len(kept) - len(topics), "runs": len(runs), "gigabytes": MOST_BYTES / 1e9}
            self._report.notes.append(RecordingText.INCOMPLETE(**figures))
        if not topics:
            return
        with new_recording(self._near) as near, new_recording(self._far) as far:
            for run in runs:
                if run.topic in topics:
                    say(f"recordings: {run.topic}")
                    self._write_run(self._kept[run.topic], near, far)
        self._report.points = [_recorded(point, topics) for point in points]
        self._report.recordings = [str(self._near), str(self._far)]

    def _write_run(self, run: KeptRun, near: McapFile, far: McapFile) -> None:
        topic = RecordedTopic(run.topic, STRING, STRING_HASH, _DESCRIPTION, Qos(depth=run.depth))
        for number, each in enumerate(read_kept(run.near), 1):
            near.add(topic, each.content, each.time + self._epoch, each.made + self._epoch, number)
        for each in read_kept(run.far):  # without numbers, as what a bridge publishes has none of the talker's
            far.add(topic, each.content, each.time + self._epoch, each.made + self._epoch)


def _smallest(runs: Iterable[Run]) -> set[str]:
    """Return the topics of as many runs as a recording has room for: the more runs, the more can be audited."""
    topics, room = set(), MOST_BYTES
    for run in sorted(runs, key=lambda each: each.size * each.sent):
        room -= run.size * run.sent
        if room < 0:
            break
        topics.add(run.topic)
    return topics


def _recorded(point: Point, topics: set[str]) -> Point:
    """Return a point whose runs have no other topics than these."""

    def recorded(run: Run) -> Run:
        return run if run.topic in topics else replace(run, topic="")

    return replace(
        point,
        gentle=recorded(point.gentle),
        best=point.best and recorded(point.best),
        full=point.full and recorded(point.full),
        paced=tuple(map(recorded, point.paced)),
    )
