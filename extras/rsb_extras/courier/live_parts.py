"""What came live on this side: the parts of its ring and of its recordings that a fetch completes."""

from __future__ import annotations

import os
import re
import shutil
import time
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import LinkError, Wording, file_stem
from rsb_extras.courier.courier_records import MARGIN, called
from rsb_extras.courier.fetch_spool import check_room
from rsb_extras.history.bridge_files import claimed_roles
from rsb_extras.recording.keep_last import RING
from rsb_extras.recording.reading.mcap_records import MCAP_MAGIC
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.recording_files import SUFFIXES, files_of
from rsb_extras.recording.reading.sqlite_bag import copy_bag, log_of
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from rsb_bridge.feature_api import Session
    from rsb_extras.courier.kept_recordings import Kept

LIVE = "live"
"""The name of the folder of a fetch with what came live."""
_QUIET_FOR = 60.0  # s without a change, after which nothing is expected to write to a database. A round figure
_MOST_FILES = 4096  # that are linked. A round figure: rings have 32 segments, and stretches about as many


class LivePartText(Wording):
    NONE = (
        "this side has no recording of {topics} from then: have what comes live kept by record: {{disk: 2}} in this "
        "side's session file, or get it without --complete"
    )
    UNKNOWN = "this side has no recording {name}: see rsb-console record list"
    SEVERAL = "this side has several recordings {name}: give its id, one of {ids}"
    UNREADABLE = "{name}: {error}"
    TOO_MANY = "the recordings of this side have more than {most} files: name one by --with"


class LivePart(NamedTuple):
    """A file with messages that came live.

    Attributes:
        begin, end: ns since the epoch.
    """

    path: Path
    begin: int
    end: int


def own_files(state: Path, session: Session, recordings: Iterable[Kept]) -> Iterator[Path]:
    """Yield the files of this bridge's ring, and of what it has recorded (`P`, `record`, stretches)."""
    stem = file_stem(session.name)
    roles = claimed_roles(state / RING, session.name)
    own = {name for name, role in roles.items() if role == session.role}
    for name in sorted(own):
        yield from sorted((state / RING / name).glob("*.mcap"))
    if roles.get(stem, session.role) == session.role:  # with no ring, there are files of `P` and `record`
        own.add(stem)
    dated = re.compile(rf"({'|'.join(map(re.escape, own))})-\d{{8}}-\d{{6}}\b.*")
    for kept in recordings:
        if own and dated.fullmatch(kept.path.name):
            with suppress(RecordingError):
                yield from files_of(kept.path)


def overlapping(files: Iterable[Path], topics: Iterable[str], begin: int, end: int) -> list[LivePart]:
    """Return the files with messages of topics around a span, each once, as the ring and stretches share theirs.

    Args:
        begin, end: ns since the epoch on this side's clock.

    Raises:
        LinkError: there are none, or too many.
    """
    wanted = {*topics}
    found: dict[tuple[int, int], LivePart] = {}
    for path in files:
        with suppress(RecordingError, OSError):
            status = path.stat()
            summary = OpenRecording(path).summary
            has = any(name in wanted and count for name, (_, count) in summary.topics.items())
            if has and summary.begin <= end + MARGIN and summary.end >= begin - MARGIN:
                part = LivePart(path, summary.begin, summary.end)
                found.setdefault((status.st_dev, status.st_ino), part)
    if not found:
        raise LinkError(LivePartText.NONE(topics=", ".join(sorted(wanted)[:3]) or "its topics"))
    if len(found) > _MOST_FILES:
        raise LinkError(LivePartText.TOO_MANY(most=_MOST_FILES))
    return sorted(found.values(), key=lambda part: (part.begin, part.path))


def named(recordings: Iterable[Kept], name: str) -> Kept:
    """Return a recording of this side by its name, its id or the begin of its name; raises LinkError."""
    found = called(name, recordings)
    if not found:
        raise LinkError(LivePartText.UNKNOWN(name=name))
    if len(found) > 1:
        raise LinkError(LivePartText.SEVERAL(name=name, ids=", ".join(each.id for each in found)))
    return found[0]


def parts_of(recording: Kept, name: str) -> list[LivePart]:
    """Return the files of a recording of this side that an operator calls `name`; raises LinkError."""
    try:
        parts = [(path, OpenRecording(path).summary) for path in files_of(recording.path)]
    except RecordingError as error:
        raise LinkError(LivePartText.UNREADABLE(name=name, error=error)) from None
    return [LivePart(path, each.begin, each.end) for path, each in parts]


def keep_parts(parts: Iterable[LivePart], folder: Path) -> None:
    """Have files stay for days: the ring lets its own go. Links where that can be, as they take no room.

    Raises:
        OSError: they cannot be kept.
    """
    folder.mkdir(0o700)
    for number, part in enumerate(parts, 1):
        target = folder / f"{number:04}{part.path.suffix if part.path.suffix in SUFFIXES else SUFFIXES[0]}"
        with suppress(FileNotFoundError):  # the ring let it go meanwhile: its messages are fetched
            _keep(part.path, target)


def _keep(path: Path, target: Path) -> None:
    if _is_done(path):
        with suppress(OSError):  # another file system
            os.link(path, target)
            return
    log = log_of(path)
    check_room(target.parent, path.stat().st_size + (log.stat().st_size if log.exists() else 0))
    if log.exists():
        copy_bag(path, target)
    else:
        shutil.copyfile(path, target)


def _is_done(path: Path) -> bool:
    """Whether nothing writes to a file any more: an MCAP file has its end then. What a fetch has must not change."""
    if path.suffix != SUFFIXES[0]:
        return time.time() - path.stat().st_mtime > _QUIET_FOR and not log_of(path).exists()
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - len(MCAP_MAGIC)))
        return file.read() == MCAP_MAGIC
