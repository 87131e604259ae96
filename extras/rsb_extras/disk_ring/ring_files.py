"""The files of the ring on disk: its segments within their bounds, and the stretch that is being kept."""

from __future__ import annotations

import errno
import re
import shutil
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.config.files import remove_file
from rsb_bridge.feature_api import Level, make_folder, why_not_written
from rsb_extras.disk_ring.ring_codes import RingCode, RingText
from rsb_extras.disk_ring.ring_rules import LONGEST_STRETCH
from rsb_extras.disk_ring.segments import SUFFIX, OpenSegment, Segment, complete, is_whole
from rsb_extras.disk_ring.stretches import FullError, StretchFolder
from rsb_extras.history.bridge_files import Claim
from rsb_extras.recording.keep_last import RECORDINGS, RING
from rsb_extras.recording.mcap_file import RecordedTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import EventLog, TopicSpec
    from rsb_extras.disk_ring.stretches import KeptStretchFolder, Occasion, Stretch
    from rsb_extras.recording import RecordLimits
    from rsb_extras.recording.latched_messages import LatchedMessages
    from rsb_extras.recording.message_ring import RingMessage

GB = 1_000_000_000
_NUMBER = re.compile(r"\d{8,}" + re.escape(SUFFIX))
_SEGMENTS = 32
"""Parts of the ring: so much of it goes at once. A round figure."""
_SMALLEST, _LARGEST = 1 << 20, 256 << 20
"""Bytes of a segment. Round figures."""
_SECONDS, _MOST_SECONDS = 30.0, 600.0
"""s of a segment: of one with four times as much as it begins with, and of any. Round figures: a stretch begins with a
segment, so up to so many s too early."""
_PART_OF_SECONDS = 8
"""Parts of `record.disk_seconds` that a segment has at most: so much of it goes at once. A round figure."""
_UNSYNCED = 32 << 20
"""Bytes that the disk need not have yet. A round figure."""
_UNCOMPRESSED_FROM = 20e6
"""Bytes a second of messages, from which segments are not compressed. At that rate, zstd takes a tenth of a core."""

_AT_ONCE = float("-inf")
"""In place of the time at which a stretch ends: it takes no more."""


class RingPlace(NamedTuple):
    """Where a bridge has its ring.

    Attributes:
        folder: the bridge's state folder.
        name: of its session.
        role: of its session.
    """

    folder: Path
    name: str
    role: str


class RingClocks(NamedTuple):
    """The clocks of an engine.

    Attributes:
        now: s on the steady clock that messages have.
        wall: s since the epoch.
    """

    now: Callable[[], float]
    wall: Callable[[], float]


class RingFiles:
    """The ring of one bridge, on one thread. All methods but `close` raise `OSError` and `McapError`.

    Args:
        described: what files say of topics, as far as known; it grows.
        latched: what late joiners get already.

    Attributes:
        folder: of its segments.
        latched: with what has come since.
    """

    def __init__(
        self,
        place: RingPlace,
        limits: RecordLimits,
        clocks: RingClocks,
        log: EventLog,
        described: Mapping[TopicSpec, RecordedTopic],
        latched: LatchedMessages,
    ) -> None:
        self._limits, self._clocks, self._log, self._described = limits, clocks, log, described
        self._claim = Claim(place.folder / RING, place.name, place.role)
        self.folder = place.folder / RING / self._claim.files.stem
        self._stretches = StretchFolder(place.folder / RECORDINGS, self._claim.files.stem, int(limits.kept * GB))
        self._size = int(limits.disk * GB)
        self._segment_size = min(max(self._size // _SEGMENTS, _SMALLEST), _LARGEST)
        of_seconds = limits.disk_seconds / _PART_OF_SECONDS
        self._segment_seconds = min(of_seconds, _SECONDS) if of_seconds else _SECONDS
        self._segments: deque[Segment] = deque()
        self._open: OpenSegment | None = None
        self._last = 0
        self._is_compressed = True
        self._unsynced = self._head = 0
        self.latched = latched
        self._stretch: Stretch | None = None
        self._until = 0.0
        self._lost_before = 0

    # --- the ring

    def begin(self) -> None:
        """Take the ring that an earlier process has left, or this one after a failure, and complete what was cut."""
        make_folder(self.folder, 0o700)
        self._segments.clear()
        cut: list[Path] = []
        for path in sorted(self.folder.iterdir()):
            if not _NUMBER.fullmatch(path.name):
                continue
            if is_whole(path):
                self._segments.append(self._found(path))
            else:
                cut.append(path)
        self.trim()
        for path in cut:
            messages, lost = complete(path)
            text = RingText.RECOVERED(path=path, messages=messages, lost=lost)
            self._log.add(Level.INFO, RingCode.RECOVERED, text)
            if messages:
                self._segments.append(self._found(path))
        self._segments = deque(sorted(self._segments, key=lambda each: each.number))
        self._last = max((each.number for each in self._segments), default=self._last)
        if self._stretch is not None:
            last = self._stretch.last
            self._add_to_stretch([each for each in self._segments if each.number > last])
        else:
            for kept in self._stretches.left(self._segments):
                self._tell(kept, RingText.KEPT_CUT)

    def _found(self, path: Path) -> Segment:
        """Return a segment that is there, by when it was written last."""
        status, now = path.stat(), self._clocks.now()
        ended = now - max(0.0, self._clocks.wall() - status.st_mtime)
        began = self._segments[-1].ended if self._segments else float("-inf")
        return Segment(path, int(path.stem), began, ended, status.st_size)

    def write(self, topic: RecordedTopic, message: RingMessage) -> None:
        segment = self._open
        if segment is None:
            segment = self._open = self._new_segment(message)
        segment.add(topic, message, message.time)
        self._unsynced += len(message.content)
        if message.topic.qos.latched:
            self.latched.add(message)
        if max(segment.size, segment.content / 4) >= self._segment_size + self._head:
            self.finish_segment()
            self.trim()
        elif self._unsynced > _UNSYNCED:
            self.sync()

    def _new_segment(self, first: RingMessage) -> OpenSegment:
        self._last += 1
        path = self.folder / f"{self._last:08d}{SUFFIX}"
        segment = OpenSegment(path, self._last, first.at, is_compressed=self._is_compressed)
        latched = [*self.latched]
        for early, each in zip(range(len(latched), 0, -1), latched, strict=True):
            topic = self._described.get(each.topic) or undescribed(each.topic)
            segment.add(topic, each, first.time - early)  # ns apart, as some readers warn of a time that comes twice
        self._head = segment.content
        return segment

    def lacks_definition(self, topic: str) -> bool:
        """Whether the segment that is being written has messages of a topic, and not its type."""
        return self._open is not None and topic in self._open.undefined

    def sync(self) -> None:
        """Have the disk hold all that was written."""
        if self._open is not None and self._unsynced:
            self._open.sync()
        self._unsynced = 0

    def finish_segment(self) -> None:
        """End the segment that is being written; the next message begins another one."""
        if self._open is None:
            return
        content, seconds = self._open.content, max(self._open.ended - self._open.began, 0.1)
        segment, self._open = self._open.finish(), None
        self._unsynced = 0
        self._is_compressed = content < seconds * _UNCOMPRESSED_FROM
        self._segments.append(segment)
        if self._stretch is not None:
            self._add_to_stretch([segment])

    def trim(self) -> None:
        """Remove the oldest segments until all bounds hold."""
        held = sum(each.size for each in self._segments)
        oldest = self._clocks.now() - (self._limits.disk_seconds or float("inf"))
        while self._segments and (
            held > self._size - self._segment_size or self._segments[0].ended < oldest or self._lacks_space()
        ):
            gone = self._segments.popleft()
            held -= gone.size
            remove_file(gone.path)
        if self._lacks_space():
            raise OSError(errno.EPERM, RingText.NO_SPACE(free=self._limits.free))

    def _lacks_space(self) -> bool:
        return shutil.disk_usage(self.folder).free < self._limits.free * GB

    def look_after(self, lost: int) -> None:
        """Do what time brings.

        Args:
            lost: messages that were not written so far.
        """
        self.sync()
        now = self._clocks.now()
        if self._open is not None:
            age, own = now - self._open.began, self._open.content - self._head
            if age >= _MOST_SECONDS or (age >= self._segment_seconds and own >= 4 * self._head):
                self.finish_segment()
        if self._stretch is not None and now >= self._until:
            self._end_stretch(lost)
        self.trim()

    def abandon(self) -> None:
        """Leave the segment that is being written as it is: writing failed."""
        if self._open is not None:
            self._open.abandon()
            self._open = None

    def end(self, lost: int) -> None:
        """End the segment and the stretch, as the bridge does."""
        if self._stretch is not None:
            self._end_stretch(lost, is_cut=True)
        self.finish_segment()

    def close(self) -> None:
        """Leave the ring to another process."""
        self.abandon()
        self._claim.close()

    # --- the stretch

    def keep(self, occasion: Occasion, lost: int) -> Path | str:
        """Keep a stretch around an occasion, or more of the one that is being kept.

        Args:
            lost: messages that were not written so far.

        Returns:
            Where it will be, or the reason why it is not kept.
        """
        try:
            if self._stretch is not None and self._until == _AT_ONCE:
                self._end_stretch(lost)
            if self._stretch is None:
                self._begin_stretch(occasion, lost)
            else:
                self._stretch.join(occasion)
        except (OSError, FullError) as error:
            return self._not_kept(occasion, error)
        assert self._stretch is not None
        until = self._stretch.occasions[0].at + LONGEST_STRETCH
        self._until = max(self._until, min(until, occasion.at + self._limits.after))
        return self._stretch.path

    def _begin_stretch(self, occasion: Occasion, lost: int) -> None:
        before = [each for each in self._segments if each.ended >= occasion.at - self._limits.before]
        self._make_room(occasion, sum(each.size for each in before))
        stretch = self._stretches.begin(occasion, self._last - (self._open is not None))
        try:
            for each in before:
                stretch.add(each)
        except OSError:
            stretch.discard()  # it would hold its files, and be finished by the next process
            raise
        self._stretch, self._until, self._lost_before = stretch, 0.0, lost

    def _add_to_stretch(self, segments: list[Segment]) -> None:
        assert self._stretch is not None
        if self._until == _AT_ONCE:  # one behind what had no room would leave a gap
            return
        try:
            for each in segments:
                self._make_room(self._stretch.occasions[0], self._stretch.size + each.size)
                self._stretch.add(each)
        except (OSError, FullError) as error:
            self._not_kept(self._stretch.occasions[0], error)
            self._until = _AT_ONCE  # with what it has

    def _make_room(self, occasion: Occasion, wanted: int) -> None:
        for path in self._stretches.make_room(wanted):
            text = RingText.REMOVED(path=path, size=self._limits.kept, reason=occasion.reason)
            self._log.add(Level.INFO, RingCode.REMOVED, text)

    def _end_stretch(self, lost: int, *, is_cut: bool = False) -> None:
        self.finish_segment()
        stretch, self._stretch = self._stretch, None
        assert stretch is not None
        try:
            kept = stretch.finish(lost - self._lost_before, is_cut=is_cut)
        except (OSError, StopIteration) as error:
            self._not_kept(stretch.occasions[0], error)
        else:
            if kept is not None:
                self._tell(kept, RingText.KEPT, reason=stretch.reason)

    def _not_kept(self, occasion: Occasion, error: Exception) -> str:
        folder = self._stretches.path
        if isinstance(error, FullError):
            text = RingText.FULL(reason=occasion.reason, folder=folder, size=self._limits.kept)
        else:
            why = why_not_written(error, folder) if isinstance(error, OSError) else str(error)
            text = RingText.NOT_KEPT(reason=occasion.reason, folder=folder, error=why)
        self._log.add(Level.WARNING, RingCode.NOT_KEPT, text)
        return text

    def _tell(self, kept: KeptStretchFolder, text: RingText, **more: str) -> None:
        messages, topics, seconds, unread = kept.figures
        for reason in unread:
            self._log.add(Level.WARNING, RingCode.UNREAD, RingText.UNREAD(path=kept.path, reason=reason))
        line = text(messages=messages, topics=topics, seconds=seconds, path=kept.path, **more)
        self._log.add(Level.INFO, RingCode.KEPT, line)


def undescribed(topic: TopicSpec) -> RecordedTopic:
    """Return what a file says of a topic whose type nobody has described yet."""
    return RecordedTopic(topic.topic, topic.type_name, topic.type_hash, "", topic.qos)
