"""The recordings that a side has in its folders, for its operators and for peers that may get them."""

from __future__ import annotations

import asyncio
import hashlib
import os
import stat
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml
from msgspec.structs import replace

from rsb_bridge.config.rights import Use
from rsb_bridge.feature_api import TEXT_LENGTH, Wording, sanitize_text, state_folder
from rsb_bridge.model.text import is_clean
from rsb_extras.courier import RECORDINGS_KEY
from rsb_extras.courier.courier_records import (
    LATEST,
    MOST_RECORDINGS,
    MOST_TOPICS,
    ListedRecording,
    ListedTopic,
)
from rsb_extras.recording.keep_last import FETCHED, RECORDINGS
from rsb_extras.recording.reading.open_recording import OpenRecording, RecordingSummary
from rsb_extras.recording.reading.recording_files import SUFFIXES, files_of
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.feature_api import Context, Rights

_MOST_FILES = 4096  # of a recording. A round figure: 4 TB in files of 1 GB
_MOST_NAMES = 10_000  # of a folder that are looked at. A round figure
_HEAD = 4096  # bytes of a file that its stamp is made of, beside size and time
_METADATA, _METADATA_LIMIT = "metadata.yaml", 1 << 20
_READ_FOR = 5.0
"""s for which a list reads recordings that it does not know yet. A round figure."""
_QUICK, _QUIET_FOR = 1.0, 60.0
"""s that reading one may take each time it has changed; s without a change after which one that takes longer is read
again: a file that is being written has no index, and a peer may ask each second. Round figures."""
_REMEMBERED = 2 * MOST_RECORDINGS


class KeptProblem(Wording):
    """The reason why a recording is not listed whole, or not given."""

    GONE = "the recording is not there any more: list the recordings again"
    CHANGED = "the recording has changed since it was listed: get it again once nothing writes to it"
    WRITTEN = "something writes to it: list the recordings again once nothing does"
    RIGHTS = "the rights of this side have changed over there meanwhile: get it again"
    READING = "it is being read for the first time: list the recordings again"


class FetchError(Exception):
    """A fetch ends; the text says why."""


class _Mark(NamedTuple):
    """A file as it was."""

    path: str
    size: int
    time: int


class Kept(NamedTuple):
    """A recording in a folder.

    Attributes:
        marks: of its files.
        stamp: of these and their beginnings.
    """

    id: str
    path: Path
    marks: tuple[_Mark, ...]
    stamp: str

    @property
    def name(self) -> str:
        """Of the file or the folder."""
        return self.path.name

    @property
    def size(self) -> int:
        return sum(mark.size for mark in self.marks)

    @property
    def changed_at(self) -> int:
        """When a file of it was changed last (ns since the epoch)."""
        return max(mark.time for mark in self.marks)

    def without_folder(self, text: str) -> str:
        """Return a text without the folder: where a recording is, is no business of a peer."""
        return text.replace(f"{self.path.parent}/", "")

    def beginning(self, size: int) -> bytes:
        """Return the first bytes of a recording of one file, or none of a folder; raises OSError."""
        return b"" if self.path.is_dir() else _read(self.path, size)

    def has_changed(self) -> bool:
        try:
            return self.marks != _marks(self.path)
        except (OSError, RecordingError):
            return True


class _Known(NamedTuple):
    """What was read of a recording.

    Attributes:
        summary: or the reason why there is none.
        about: cause and note.
        seconds: that it took.
    """

    stamp: str
    summary: RecordingSummary | str
    about: tuple[str, str]
    seconds: float


class KeptRecordings:
    """Finds the recordings of this side, and what is in them.

    Attributes:
        recorded: the folder of the bridge's own recordings.
        fetched: the folder of those from the other side, which no peer gets from here.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self.recorded = state_folder(os.environ) / RECORDINGS
        self.fetched = self.recorded / FETCHED
        self._known: dict[str, _Known] = {}
        """By ids. The one that was asked for last is last."""
        self._listing = asyncio.Lock()

    async def all(self, rights: Rights | None) -> list[ListedRecording]:
        """Return the newest recordings, by their ids. Those that would take too long to read now say so.

        Args:
            rights: of the peer that asks, or None for this side's operators, who also get those that were fetched.
        """
        async with self._listing:
            deadline = self._context.now() + _READ_FOR
            found = await asyncio.to_thread(self._list, rights, MOST_RECORDINGS, lambda: self._context.now() > deadline)
            return sorted(found, key=lambda each: each.id)

    async def newest(self, most: int) -> list[ListedRecording]:
        """Return those that came last, for this side's operators, the newest first and without their topics."""
        async with self._listing:
            deadline = self._context.now() + _READ_FOR
            found = await asyncio.to_thread(self._newest, most, lambda: self._context.now() > deadline)
            return [replace(each, topics=()) for each in found]

    def _list(self, rights: Rights | None, most: int, stop: Callable[[], bool]) -> list[ListedRecording]:
        found = sorted(self._found(fetched=rights is None), key=lambda each: each.changed_at, reverse=True)
        return [self._listed(each, rights, stop) for each in found[:most]]

    def _newest(self, most: int, stop: Callable[[], bool]) -> list[ListedRecording]:
        """Look into those alone whose files have changed last: a tile asks for them again and again."""
        places = sorted(self._places(fetched=True), key=lambda place: _changed_at(*place), reverse=True)
        found = islice(filter(None, (_kept(*place) for place in places)), most)
        newest = sorted(found, key=lambda each: each.changed_at, reverse=True)
        return [self._listed(each, None, stop) for each in newest]

    def find(self, key: str, stamp: str) -> Kept:
        """Return one that a peer may get, on any thread.

        Raises:
            FetchError: it is not there, or another one by now.
        """
        for kept in self._found(fetched=False):
            if kept.id == key:
                if kept.stamp != stamp:
                    raise FetchError(KeptProblem.CHANGED())
                return kept
        raise FetchError(KeptProblem.GONE())

    def of_this_side(self) -> Iterator[Kept]:
        """Yield all recordings of this side, also those that were fetched, on any thread."""
        return self._found(fetched=True)

    def own(self) -> Iterator[Kept]:
        """Yield the bridge's own recordings, on any thread."""
        return (kept for kept in self._found(fetched=False) if kept.path.parent == self.recorded)

    def _found(self, *, fetched: bool) -> Iterator[Kept]:
        for folder, name in self._places(fetched=fetched):
            if (kept := _kept(folder, name)) is not None:
                yield kept

    def _places(self, *, fetched: bool) -> Iterator[tuple[Path, str]]:
        """Yield the folders and names of what may be recordings, folder by folder and by their names."""
        folders = [self.recorded, *map(Path, RECORDINGS_KEY.of(self._context.session).folders)]
        if fetched:
            folders.append(self.fetched)
        for folder in dict.fromkeys(folders):
            try:
                names = sorted(each.name for each in islice(Path(folder).iterdir(), _MOST_NAMES))
            except OSError:
                continue
            for name in names:
                if not name.startswith(".") and folder / name != self.fetched:
                    yield folder, name

    def _listed(self, kept: Kept, rights: Rights | None, stop: Callable[[], bool]) -> ListedRecording:
        summary, (cause, note) = self._summary(kept, stop)
        listed = ListedRecording(
            kept.id, sanitize_text(kept.path.name, TEXT_LENGTH), kept.stamp, kept.size, cause=cause, note=note
        )
        if isinstance(summary, str):
            return replace(listed, problem=sanitize_text(summary))
        topics = [
            ListedTopic(name, sanitize_text(type_name, TEXT_LENGTH), count)
            for name, (type_name, count) in sorted(summary.topics.items())
            if _is_name(name) and (rights is None or may_read(rights, name))
        ]
        return replace(
            listed, begin=min(max(0, summary.begin), LATEST), end=min(max(0, summary.end), LATEST),
            messages=sum(each.messages for each in topics), topics=tuple(topics[:MOST_TOPICS]),
            more_topics=max(0, len(topics) - MOST_TOPICS), problem=sanitize_text(summary.cut),
        )  # fmt: skip

    def _summary(self, kept: Kept, stop: Callable[[], bool]) -> tuple[RecordingSummary | str, tuple[str, str]]:
        if (known := self._known.pop(kept.id, None)) is not None:
            if known.stamp == kept.stamp:
                self._known[kept.id] = known
                return known.summary, known.about
            if known.seconds > _QUICK and self._context.wall() - kept.changed_at / 1e9 < _QUIET_FOR:
                self._known[kept.id] = known
                return KeptProblem.WRITTEN(), known.about
        if stop():
            return KeptProblem.READING(), ("", "")
        summary: RecordingSummary | str
        began = self._context.now()
        try:
            summary = OpenRecording(kept.path).summary
        except (RecordingError, OSError) as error:
            summary = kept.without_folder(str(error))
        about = _cause_and_note(kept.path)
        self._known[kept.id] = _Known(kept.stamp, summary, about, self._context.now() - began)
        while len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
        return summary, about


def may_read(rights: Rights, topic: str) -> bool:
    """Whether a peer may read a topic: what it may not see while it is published, it does not get later either."""
    return rights.refusal(Use(topic, "read")) is None


def _is_name(name: str) -> bool:
    return 0 < len(name) <= TEXT_LENGTH and is_clean(name)


def _changed_at(folder: Path, name: str) -> int:
    """Return when a file of what may be a recording was changed last (ns since the epoch), or 0 if it is none.

    The time of a bag's folder is that of its names: it stays while its one file grows.
    """
    path = folder / name
    try:
        status = path.lstat()
        if not stat.S_ISDIR(status.st_mode):
            return status.st_mtime_ns if stat.S_ISREG(status.st_mode) else 0
        with os.scandir(path) as files:
            found = [each for each in islice(files, _MOST_FILES) if each.name.endswith(SUFFIXES)]
            return max((each.stat(follow_symlinks=False).st_mtime_ns for each in found), default=0)
    except OSError:  # it has gone meanwhile, or is nobody's to read
        return 0


def _kept(folder: Path, name: str) -> Kept | None:
    path = folder / name
    try:
        status = path.lstat()
        is_one = stat.S_ISDIR(status.st_mode) or (stat.S_ISREG(status.st_mode) and name.endswith(SUFFIXES))
        marks = _marks(path) if is_one else ()
        stamp = hashlib.sha256(repr(marks).encode())
        for mark in marks:
            stamp.update(_beginning(mark.path))
    except (OSError, RecordingError, ValueError):
        return None
    key = hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
    return Kept(key, path, marks, stamp.hexdigest()[:16]) if marks else None


def _marks(path: Path) -> tuple[_Mark, ...]:
    """Return the marks of a recording's files, or nothing if one is no plain file: nothing waits for a FIFO here."""
    files = files_of(path)
    found = [(str(file), file.lstat()) for file in files[:_MOST_FILES]]
    if len(files) > _MOST_FILES or not all(stat.S_ISREG(status.st_mode) for _, status in found):
        return ()
    return tuple(_Mark(name, status.st_size, status.st_mtime_ns) for name, status in found)


def _beginning(path: str) -> bytes:
    return _read(Path(path), _HEAD)


def _cause_and_note(path: Path) -> tuple[str, str]:
    """Return what the metadata of a folder says of why it was kept, or empty texts."""
    try:
        content = _read(path / _METADATA, _METADATA_LIMIT)
        data = yaml.load(content, Loader=yaml.CSafeLoader)["rosbag2_bagfile_information"]["custom_data"]
        cause, note, text = (_text(data.get(name)) for name in ("cause", "note", "text"))
    except Exception:  # noqa: BLE001 -- it is a comfort, and may say anything
        return "", ""
    return cause, note or text


def _text(value: object) -> str:
    """Return a text, or an empty one for anything else: lists of lists may take all memory as text."""
    return sanitize_text(value, TEXT_LENGTH) if isinstance(value, str) else ""


def _read(path: Path, size: int) -> bytes:
    """Read the beginning of a plain file; raises OSError."""
    with open(path, "rb", opener=_opener) as file:
        return file.read(size)


def _opener(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)
