"""A fetch on disk: what was asked for, and the pieces that have come, each a file. A bridge goes on from there."""

from __future__ import annotations

import errno
import shutil
import threading
from abc import ABC, abstractmethod
from contextlib import suppress
from itertools import count, islice
from typing import TYPE_CHECKING, TypeVar

import msgspec

from rsb_bridge.config.files import UNFINISHED, is_there
from rsb_bridge.feature_api import Count, Name, Wording, make_folder, replace_file
from rsb_extras.courier.completed_recording import AskedCompletion
from rsb_extras.courier.courier_records import Cursor, ListedRecording, Wanted
from rsb_extras.courier.kept_recordings import FetchError, KeptProblem
from rsb_extras.courier.pieces import (
    MOST_CHANNELS,
    Channels,
    Joiner,
    Piece,
    PieceError,
    PieceProblem,
    check_follows,
    decode_piece,
)
from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.open_recording import summary_of
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from typing import Self

    from rsb_extras.courier.completed_recording import CompletedRecording
    from rsb_extras.recording.reading.stored_message import StoredMessage

_T = TypeVar("_T")

SPOOL, GONE = ".fetch", ".gone"
"""The end of the name of a fetch's folder, and of one that is being removed; they begin with a dot."""
_ASKED = "asked.json"
_PIECE = ".piece"
_LEFT_FREE = 1 << 30
"""Bytes of the file system that a fetch leaves: a peer must not fill the disk. A round figure."""
_TIMES_LARGER = 4
"""Pieces are at most so many times larger than the recording, which may be packed better than these, and `_MORE`."""
_MORE = 64 << 20


class SpoolProblem(Wording):
    DISK_FULL = "{folder} has less than {least:.0f} GB of free space: make room there"
    TOO_MUCH = "more came than the recording has"


class AskedFetch(msgspec.Struct, frozen=True):
    """What an operator has asked for.

    Attributes:
        name: of the fetch, and of the file without its suffix.
        owner: role and name of the session.
        who: the operator.
        completes: what is completed, or None if all that is wanted is got.
    """

    name: str
    owner: str
    link: Name
    listed: ListedRecording
    wanted: Wanted
    who: str = ""
    completes: AskedCompletion | None = None


class PieceRow:
    """Pieces of one order in a folder. Its methods are for any thread: one that was given up may still be at work.

    Args:
        size: bytes of the recording.
        working: of the fetch.
        channels: of rows before it, which need not cross again.

    Attributes:
        at: where the next piece begins.
        known: channels that have come.
        taken: bytes of the pieces.
        is_whole: whether nothing is missing.
        damage: why the rest of the recording could not be read, or empty.
        denied: topics that this side may not read.
    """

    def __init__(
        self, folder: Path, wanted: Wanted, size: int, working: threading.RLock, channels: Channels | None = None
    ) -> None:
        self.folder, self.wanted = folder, wanted
        self._size = size
        self._channels = channels or {}
        self.at = Cursor(wanted.begin)
        self.known: set[bytes] = {*self._channels}
        self.taken: Count = 0
        self.is_whole = False
        self.damage = ""
        self.denied: tuple[str, ...] = ()
        self._pieces = 0
        self._working = working

    def load(self, stop: Callable[[], bool]) -> None:
        """Take up the pieces that are whole, unless told to stop."""
        try:
            for data in self._read():
                if stop():
                    return
                self._count(decode_piece(data), len(data))
        except (PieceError, FetchError, OSError):  # the disk has lost a part of it: it is got again
            pass

    def _read(self) -> Iterator[bytes]:
        for number in count(1):
            if not (path := self._path(number)).exists():
                return
            yield path.read_bytes()

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:08}{_PIECE}"

    def _count(self, piece: Piece, size: int) -> None:
        check_follows(piece, self.at)
        if self._pieces and piece.denied != self.denied:  # a place among other messages is another place
            raise FetchError(KeptProblem.RIGHTS())
        self.known.update(piece.content().channels)
        if len(self.known) > MOST_CHANNELS:
            raise PieceError(PieceProblem.TOO_MANY_CHANNELS(most=MOST_CHANNELS))
        self.at, self.is_whole, self.damage, self.denied = piece.end, piece.is_last, piece.damage, piece.denied
        self.taken += size
        self._pieces += 1

    def add(self, piece: Piece, data: bytes) -> None:
        """Keep a piece. One that a power cut takes is missed by its hash, and got again: no piece waits for the disk.

        Raises:
            PieceError: it is not the next one, or holds what no recording has.
            FetchError: this side may read other topics by now.
            OSError: it cannot be written.
        """
        if self.taken > _TIMES_LARGER * self._size + _MORE:
            raise PieceError(SpoolProblem.TOO_MUCH())
        with self._working:
            check_room(self.folder)
            check_follows(piece, self.at)
            self._path(self._pieces + 1).write_bytes(data)
            self._count(piece, len(data))

    def messages(self) -> Iterator[StoredMessage]:
        """Yield all messages of the pieces, in their order; raises `PieceError`, OSError."""
        joiner = Joiner(self.wanted.topics, self.wanted.begin, self.wanted.end, self._channels)
        for data in islice(self._read(), self._pieces):
            check_room(self.folder)
            yield from joiner.add(decode_piece(data).content())
        joiner.finish()

    def share(self, listed: ListedRecording) -> float:
        """Return the part of the span that has come, by the time of its messages."""
        begin, end = max(self.wanted.begin, listed.begin), min(self.wanted.end, listed.end)
        if self.is_whole:
            return 1.0
        return min(max(0.0, (self.at.time - begin) / (end - begin)), 1.0) if end > begin else 0.0

    def channels(self) -> Channels:
        """Return those that have come, by their ids; raises `PieceError`, OSError."""
        found = dict(self._channels)
        for data in islice(self._read(), self._pieces):
            found.update(decode_piece(data).content().channels)
        return found


def check_room(folder: Path, wanted: int = 0) -> None:
    """Raise OSError if so many bytes leave less than has to stay free."""
    if shutil.disk_usage(folder).free < _LEFT_FREE + wanted:
        problem = SpoolProblem.DISK_FULL(folder=folder.parent, least=(_LEFT_FREE + wanted) / 1e9)
        raise OSError(errno.ENOSPC, problem)


class Spool(ABC):
    """The folder of a fetch. Its methods are for any thread: one that was given up may still be at work.

    Attributes:
        completed: what is in the file, once it is written, of a fetch that completes something; or None.
        path: of the file. It gets a number if another one has taken its name meanwhile.
    """

    def __init__(self, folder: Path, asked: AskedFetch) -> None:
        self.folder, self.asked = folder, asked
        self.completed: CompletedRecording | None = None
        self.path = folder.parent / f"{asked.name}.mcap"
        self._working = threading.RLock()

    def make(self) -> Self:
        """Make the folder; raises OSError."""
        make_folder(self.folder.parent, 0o700)
        self.folder.mkdir(0o700)
        try:
            replace_file(self.folder / _ASKED, msgspec.json.encode(self.asked))  # first: so it is known whose it is
            self._prepare()
        except BaseException:
            self.remove()
            raise
        return self

    def _prepare(self) -> None:  # noqa: B027 -- a plain fetch needs nothing
        """Put into the folder what has to be there beside the pieces; raises OSError."""

    @property
    def is_made(self) -> bool:
        """Whether the folder has what has to be there: a bridge may have been killed before."""
        return True

    @property
    @abstractmethod
    def rows(self) -> Sequence[PieceRow]:
        """Those of which pieces have come, or are to come next."""

    @property
    @abstractmethod
    def share(self) -> float:
        """The part that has come."""

    @property
    def taken(self) -> int:
        """Bytes of all pieces."""
        return sum(row.taken for row in self.rows)

    @property
    def damage(self) -> str:
        """The reason why the rest of the recording could not be read, or an empty text."""
        return self.rows[0].damage

    @abstractmethod
    def next_row(self, stop: Callable[[], bool]) -> PieceRow | None:
        """Return the pieces to get next, or None if all have come; raises as `write`."""

    def write(self, stop: Callable[[], bool]) -> int:
        """Write the file of all pieces, unless told to stop, and remove them; return the number of messages.

        Raises:
            PieceError: the pieces are no recording.
            McapError: MCAP's library is not installed.
            OSError: it cannot be written.
            InterruptedError: it was told to stop.
        """
        with self._working:
            if stop():  # before it began
                raise InterruptedError
            for number in count(2):
                self.path.with_name(f".{self.path.name}{UNFINISHED}").unlink(missing_ok=True)  # of a killed bridge
                if not is_there(self.path):
                    break
                if written := self._written():  # by a bridge that was killed before it removed the pieces
                    self.remove()
                    return written
                self.path = self.folder.parent / f"{self.asked.name}-{number}.mcap"  # an operator has put one there
            written = self._write(stop)
            self.remove()
            return written

    def _written(self) -> int:
        """Return how many messages the file by the name of this one has if it has all of this one, else 0."""
        return 0

    @abstractmethod
    def _write(self, stop: Callable[[], bool]) -> int: ...

    def close(self) -> None:  # noqa: B027 -- a plain fetch has nothing open
        """Release what is open; the folder stays."""

    def remove(self) -> None:
        with self._working:
            gone = self.folder
            with suppress(OSError):
                gone = self.folder.rename(self.folder.with_suffix(GONE))  # half of it would be taken up as a fetch
            shutil.rmtree(gone, ignore_errors=True)


class FetchSpool(Spool):
    """The folder of a fetch of all that is wanted."""

    def __init__(self, folder: Path, asked: AskedFetch) -> None:
        super().__init__(folder, asked)
        self.row = PieceRow(folder, asked.wanted, asked.listed.size, self._working)

    @property
    def rows(self) -> Sequence[PieceRow]:
        return (self.row,)

    @property
    def share(self) -> float:
        return self.row.share(self.asked.listed)

    def next_row(self, stop: Callable[[], bool]) -> PieceRow | None:
        return None if self.row.is_whole else self.row

    def _write(self, stop: Callable[[], bool]) -> int:
        check_room(self.folder, self.taken)
        with new_recording(self.path) as recording:
            for message in until(self.row.messages(), stop):
                recording.copy(message)
        return recording.messages

    def _written(self) -> int:
        try:
            written = summary_of(self.path).messages
        except RecordingError:
            return 0
        return written if written == sum(1 for _ in self.row.messages()) else 0


def until(messages: Iterator[_T], stop: Callable[[], bool]) -> Iterator[_T]:
    """Yield all; raises InterruptedError once told to stop."""
    for message in messages:
        if stop():
            raise InterruptedError
        yield message


def load_asked(folder: Path) -> AskedFetch | None:
    """Return what a fetch's folder was made for, or None if it is none."""
    try:
        return msgspec.json.decode((folder / _ASKED).read_bytes(), type=AskedFetch)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None
