"""The engine's part: keeps the last messages of all bridged topics, and writes them to a file."""

from __future__ import annotations

import asyncio
import os
import threading
from contextlib import suppress
from datetime import datetime
from enum import StrEnum
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from rsb_bridge.config.files import UNFINISHED, remove_file, stat_of
from rsb_bridge.feature_api import (
    EnginePart,
    LinkError,
    Wording,
    file_stem,
    make_folder,
    state_folder,
    why_not_written,
)
from rsb_extras.recording import RECORD, record_limits
from rsb_extras.recording.keep_last import RECORDINGS, TOPICS_NAMED, KeepLast, KeptRecording
from rsb_extras.recording.mcap_file import McapError, new_recording
from rsb_extras.recording.message_ring import MessageRing, RingMessage, of_last
from rsb_extras.recording.passing_messages import passing_messages, recorded_topic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Context, Snapshot, TopicSpec
    from rsb_extras.recording.mcap_file import McapFile, RecordedTopic

FOLDER_SIZE = 2 << 30
"""Bytes of all recordings in the folder, beyond which there are no more: a console must not fill the disk. A round
figure."""
_NAMES = 100
"""Files of one second: a round figure. Another one is refused."""
_LEFT_AFTER = 3600.0
"""s in which nothing was written to an unfinished file until it is removed. A round figure: all take seconds."""
_BREATH_AFTER, _BREATH = 64 << 10, 0.0005
"""Bytes that are written before the thread lets others run, and for how long (s): without, the loop stood still for
5 ms at a time."""


class RecordCode(StrEnum):
    WRITTEN = "record.written"


class KeepProblem(Wording):
    """The reason why nothing is written."""

    OFF = "nothing is kept: set record: true in the bridge's session file, and reload it"
    NOTHING_YET = "no message has passed yet that could be written"
    BUSY = "a recording is being written already: wait until it is done"
    NOT_WRITTEN = "{path} is not written: {reason}"
    FOLDER_FULL = "{folder} has {size:.1f} GB of recordings: move or remove some"
    STOPPED = "the bridge stops"


class _Window(NamedTuple):
    """What is written.

    Attributes:
        latched: what late joiners had got when it began.
        messages: all since then, oldest first.
    """

    latched: Sequence[RingMessage]
    messages: Sequence[RingMessage]
    topics: tuple[TopicSpec, ...]

    @property
    def began(self) -> int:
        """When it began (ns since the epoch). Earlier messages get this time, or players would wait for the others."""
        return (self.messages or self.latched)[0].time


def _window(latched: Sequence[RingMessage], messages: Sequence[RingMessage], began: float) -> _Window:
    window = of_last(latched, messages, began)
    topics = {id(each.topic): each.topic for part in window for each in part}
    return _Window(*window, tuple(dict.fromkeys(topics.values())))


class Keeping(EnginePart):
    """Answers `KeepLast`. While the session keeps nothing, no route has a tap.

    Attributes:
        ring: what is kept, or None while nothing is.
    """

    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._context: Context = bridge.context
        self._passing = passing_messages(bridge)
        self.ring: MessageRing | None = None
        self._writing = asyncio.Lock()
        self._stopping = threading.Event()
        self.handlers = {KeepLast: self._keep}
        self.by_key = (((RECORD.name,), self._switch),)

    def open(self) -> None:
        self._switch()

    def tick(self, snapshot: Snapshot) -> None:
        if self.ring is not None:
            self.ring.trim(self._context.now())

    async def close(self) -> None:
        self._stopping.set()
        async with self._writing:  # its thread ends soon
            self._set_ring(None)

    def _switch(self) -> None:
        limits = record_limits(self._context.session)
        self._set_ring(None if limits is None else MessageRing(limits.seconds, int(limits.megabytes * (1 << 20))))

    def _set_ring(self, ring: MessageRing | None) -> None:
        """Keep messages in a new ring, or none, of all present and coming routes."""
        if self.ring is not None:
            self._passing.end(self.ring.add)
        self.ring = ring
        if ring is not None:
            self._passing.give(ring.add)

    # --- writing

    async def _keep(self, command: KeepLast) -> KeptRecording:
        ring = self.ring
        if ring is None:
            raise LinkError(KeepProblem.OFF())
        if self._writing.locked():
            raise LinkError(KeepProblem.BUSY())
        async with self._writing:
            now = self._context.now()
            began = now - (ring.seconds if command.seconds is None else command.seconds)
            window = await asyncio.to_thread(_window, *ring.copy(now), began)
            if not window.topics:
                raise LinkError(KeepProblem.NOTHING_YET())
            described = await self._described(window.topics)
            undescribed = [each.topic for each in described.values() if not each.description]
            kept = await self._written(window, described)
        kept = replace(kept, undescribed=tuple(undescribed[:TOPICS_NAMED]), too_large=ring.left_out)
        self._bridge.log.add(RecordCode.WRITTEN, f"{kept.messages:,} messages written to {kept.path}")
        return kept

    async def _described(self, topics: Sequence[TopicSpec]) -> dict[TopicSpec, RecordedTopic]:
        """Return what a file says of topics."""
        return {each: await recorded_topic(self._context, each) for each in topics}

    async def _written(self, window: _Window, described: Mapping[TopicSpec, RecordedTopic]) -> KeptRecording:
        folder = state_folder(os.environ) / RECORDINGS
        stem = f"{file_stem(self._context.session.name)}-{datetime.fromtimestamp(self._context.wall()):%Y%m%d-%H%M%S}"
        try:
            return await asyncio.to_thread(self._write, folder, stem, window, described)
        except McapError as error:
            raise LinkError(str(error)) from None
        except OSError as error:
            reason = why_not_written(error, folder)
            raise LinkError(KeepProblem.NOT_WRITTEN(path=error.filename or folder, reason=reason)) from None

    def _write(
        self, folder: Path, stem: str, window: _Window, described: Mapping[TopicSpec, RecordedTopic]
    ) -> KeptRecording:
        """Write a file, on a thread."""
        make_folder(folder, 0o700)
        _remove_unfinished(folder, self._context.wall())
        # Another bridge may finish one meanwhile.
        found = map(stat_of, chain(folder.glob(f".*{UNFINISHED}"), folder.glob("*.mcap")))
        if (size := sum(each.st_size for each in found if each is not None)) > FOLDER_SIZE:
            raise LinkError(KeepProblem.FOLDER_FULL(folder=folder, size=size / 1e9))
        path = _free_path(folder, stem)
        with new_recording(path) as recording:
            last = self._write_messages(recording, window, described)
            count = recording.messages
        seconds = max(0, last - window.began) / 1e9
        return KeptRecording(str(path), os.uname().nodename, count, len(described), seconds, path.stat().st_size)

    def _write_messages(
        self, recording: McapFile, window: _Window, described: Mapping[TopicSpec, RecordedTopic]
    ) -> int:
        """Write the messages of a window, and return when the last one passed (ns since the epoch)."""
        began, last, unbroken = window.began, window.began, 0
        topics = {id(each): described[each] for each in window.topics}
        for is_latched, messages in ((True, window.latched), (False, window.messages)):
            for number, each in enumerate(messages):
                topic = topics.get(id(each.topic)) or described[each.topic]
                # ns apart, as some readers warn of a time that comes twice.
                last = began - len(messages) + number if is_latched else each.time
                recording.add(topic, each.content, last, each.published, each.number)
                unbroken += each.cost
                if unbroken > _BREATH_AFTER:
                    unbroken = 0
                    if self._stopping.wait(_BREATH):
                        raise LinkError(KeepProblem.STOPPED())
        return last


def _remove_unfinished(folder: Path, wall: float) -> None:
    """Remove what bridges left that were killed while they wrote, at `wall` (s since the epoch)."""
    for part in folder.glob(f".*.mcap{UNFINISHED}"):  # not the folders of stretches (`rsb_extras.disk_ring`)
        with suppress(FileNotFoundError):  # another bridge has finished it
            if wall - part.stat().st_mtime > _LEFT_AFTER:
                remove_file(part)


def _free_path(folder: Path, stem: str) -> Path:
    """Return a path without a file yet. If another process takes it first, that is an error of writing it."""
    paths = (folder / f"{stem}{f'-{number}' if number > 1 else ''}.mcap" for number in range(1, _NAMES))
    return next(path for path in paths if not path.exists())
