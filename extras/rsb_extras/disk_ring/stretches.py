"""Stretches of the ring that are kept: folders of segments, each a recording of its own."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from datetime import datetime
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import msgspec

from rsb_bridge.config.files import UNFINISHED, stat_of
from rsb_bridge.feature_api import make_folder, replace_file, sync_folder
from rsb_extras.disk_ring.bag_metadata import NAME, BagFigures, bag_metadata
from rsb_extras.disk_ring.segments import SUFFIX

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from rsb_extras.disk_ring.segments import Segment

Reason: TypeAlias = Literal["fault", "link", "disarm", "note"]
NOTE: Reason = "note"
_AUTOMATIC = re.compile(r"-\d{8}-\d{6}-(fault|link|disarm)(-\d+)?$")
"""The end of the name of a stretch that no operator has asked for."""
_STATE = "stretch.json"
_NAMES = 100
"""Stretches of one second and cause. A round figure: another one is refused."""
_ENDED = 1 << 62
"""In place of a segment's number: no later one belongs to the stretch."""
_CAUSES = 100
"""Causes of one stretch that are written down. A round figure: a fault may come and go for minutes."""


class Occasion(msgspec.Struct, frozen=True):
    """Why a stretch is kept.

    Attributes:
        at: s on the steady clock, when it was.
        time: s since the epoch.
        text: a fault in words, or an operator's note.
        subject: the topic or the link, or empty.
    """

    at: float
    time: float
    reason: Reason
    text: str = ""
    subject: str = ""


class _State(msgspec.Struct):
    """What survives a power cut of a stretch that has not ended.

    Attributes:
        last: number of the newest segment that needs no more to be added.
    """

    occasions: list[Occasion]
    last: int


class KeptStretchFolder(NamedTuple):
    """A stretch that is whole."""

    path: Path
    size: int
    figures: BagFigures


class FullError(Exception):
    """There is no room for a stretch that nobody may remove but an operator."""


class Stretch:
    """A stretch that is being kept, in a hidden folder until it ends.

    Its segments are the ring's own files, by a second name each: keeping one copies nothing.

    Attributes:
        size: bytes of its segments so far.
    """

    def __init__(self, part: Path, stem: str, state: _State) -> None:
        self._part = part
        self._stem = stem
        self._state = state
        self.size = 0
        self._save()

    @property
    def last(self) -> int:
        """Number of the newest segment that needs no more to be added."""
        return self._state.last

    @property
    def occasions(self) -> Sequence[Occasion]:
        return self._state.occasions

    @property
    def reason(self) -> Reason:
        """The first occasion's, or a note, which protects it."""
        reasons = [each.reason for each in self.occasions]
        return NOTE if NOTE in reasons else reasons[0]

    @property
    def path(self) -> Path:
        """Where it will be, as far as is known now."""
        return _free_path(self._part.parent, self._name)

    @property
    def _name(self) -> str:
        moment = datetime.fromtimestamp(self.occasions[0].time)
        return f"{self._stem}-{moment:%Y%m%d-%H%M%S}-{self.reason}"

    def join(self, occasion: Occasion) -> None:
        """Add an occasion within the same stretch."""
        if len(self._state.occasions) < _CAUSES or occasion.reason == NOTE:
            self._state.occasions.append(occasion)
            self._save()

    def add(self, segment: Segment) -> None:
        """Keep a segment.

        Raises:
            OSError: it cannot be.
        """
        target = self._part / segment.path.name
        try:
            os.link(segment.path, target)
        except FileExistsError:
            pass
        except OSError:  # a file system without links: a copy takes its time, and its room
            shutil.copyfile(segment.path, target)
        self._state.last = segment.number
        self.size += segment.size
        self._save()

    def discard(self) -> None:
        """Remove it: not all could be kept."""
        shutil.rmtree(self._part, ignore_errors=True)

    def finish(self, lost: int, *, is_cut: bool = False) -> KeptStretchFolder | None:
        """Give it its name, or remove it if nothing is in it.

        Args:
            lost: messages that were not written meanwhile.
            is_cut: whether the bridge ended before the stretch did.
        """
        parts = sorted(self._part.glob(f"*{SUFFIX}"), key=lambda part: (part.stat().st_mtime_ns, part.name))
        if not parts:
            shutil.rmtree(self._part)
            return None
        path, self._state.last = self.path, _ENDED
        self._save()
        files = [part.rename(part.with_name(f"{path.name}_{number}{SUFFIX}")) for number, part in enumerate(parts)]
        text, figures = bag_metadata(files, self._custom(lost, is_cut=is_cut))
        replace_file(self._part / NAME, text.encode())
        self._part.rename(path)
        (path / _STATE).unlink(missing_ok=True)  # not before: without it, the part would be taken for an empty one
        sync_folder(path.parent)
        return KeptStretchFolder(path, size_of(path), figures)

    def _custom(self, lost: int, *, is_cut: bool) -> dict[str, str]:
        first = self.occasions[0]
        custom = {"cause": self.reason, "text": first.text, "subject": first.subject, "time": f"{first.time:.3f}"}
        if notes := [each.text for each in self.occasions if each.reason == NOTE and each.text]:
            custom["note"] = "; ".join(notes)
        if others := self.occasions[1:]:
            custom["also"] = "; ".join(f"{each.time:.3f} {each.reason} {each.subject} {each.text}" for each in others)
        if lost:
            custom["lost"] = str(lost)
        if is_cut:
            custom["cut"] = "the bridge ended before this stretch did"
        return custom

    def _save(self) -> None:
        replace_file(self._part / _STATE, msgspec.json.encode(self._state))


class StretchFolder:
    """The folder of all stretches, of this bridge and others of this user.

    Args:
        stem: the session's name as a file's.
        size: bytes of all stretches, beyond which the oldest goes that no operator has asked for.
    """

    def __init__(self, path: Path, stem: str, size: int) -> None:
        self.path = path
        self.size = size
        self._stem = stem

    def begin(self, occasion: Occasion, last: int) -> Stretch:
        """Begin a stretch.

        Args:
            last: number of the ring's newest segment that is finished, or 0.

        Raises:
            OSError: it cannot be written.
        """
        make_folder(self.path, 0o700)
        part = self.path / f".{self._stem}-{int(occasion.time * 1e3)}{UNFINISHED}"
        make_folder(part, 0o700)
        return Stretch(part, self._stem, _State([occasion], last))

    def make_room(self, wanted: int) -> Iterator[Path]:
        """Remove the oldest stretches that no operator has asked for, until so many bytes have room; yield each.

        Raises:
            FullError: operators' stretches leave no room. None is removed.
            OSError: one cannot be removed.
        """
        found = sorted(self._whole(), key=lambda path: (path / NAME).stat().st_mtime)
        sizes = {path: size_of(path) for path in found}
        removable = [path for path in found if _AUTOMATIC.search(path.name)]
        total = sum(sizes.values()) + wanted
        if total - sum(sizes[path] for path in removable) > self.size:
            raise FullError
        for path in removable:
            if total <= self.size:
                return
            shutil.rmtree(path)
            total -= sizes[path]
            yield path

    def _whole(self) -> Iterator[Path]:
        with contextlib.suppress(FileNotFoundError):
            for path in self.path.iterdir():
                if not path.name.startswith(".") and stat_of(path / NAME) is not None:
                    yield path

    def left(self, segments: Iterable[Segment]) -> Iterator[KeptStretchFolder]:
        """Finish the stretches that an earlier process of this bridge has left, with what came before it ended.

        Args:
            segments: of the ring, complete by now.
        """
        own = re.compile(rf"\.{re.escape(self._stem)}-\d+{re.escape(UNFINISHED)}")
        for part in sorted(each for each in self.path.glob(f"*{UNFINISHED}") if own.fullmatch(each.name)):
            try:
                state = msgspec.json.decode((part / _STATE).read_bytes(), type=_State)
            except (OSError, msgspec.DecodeError):  # it had only begun
                shutil.rmtree(part, ignore_errors=True)
                continue
            stretch = Stretch(part, self._stem, state)
            for segment in segments:
                if segment.number > state.last:
                    stretch.add(segment)
            if (kept := stretch.finish(0, is_cut=True)) is not None:
                yield kept


def size_of(folder: Path) -> int:
    """Return the bytes of a folder's files."""
    return sum(each.stat().st_size for each in folder.iterdir() if each.is_file())


def _free_path(folder: Path, name: str) -> Path:
    paths = (folder / f"{name}{f'-{number}' if number > 1 else ''}" for number in range(1, _NAMES))
    return next(path for path in paths if not path.exists())
