"""A fetch on disk: what was asked for, and the pieces that have come, each a file. A bridge goes on from there."""

from __future__ import annotations

import errno
import shutil
import threading
from itertools import count, islice
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.files import UNFINISHED, is_there
from rsb_bridge.feature_api import Count, Name, Wording, make_folder, replace_file
from rsb_extras.courier.courier_records import Cursor, ListedRecording, Wanted
from rsb_extras.courier.pieces import (
    MOST_CHANNELS,
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
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rsb_extras.recording.reading.stored_message import StoredMessage

SPOOL = ".fetch"
"""The end of the name of a fetch's folder; it begins with a dot."""
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
    """

    name: str
    owner: str
    link: Name
    listed: ListedRecording
    wanted: Wanted
    who: str = ""


class FetchSpool:
    """The folder of a fetch. Its methods are for any thread: one that was given up may still be at work.

    Attributes:
        at: where the next piece begins.
        known: channels that have come.
        taken: bytes of the pieces.
        is_whole: whether nothing is missing.
        damage: why the rest of the recording could not be read, or empty.
    """

    def __init__(self, folder: Path, asked: AskedFetch) -> None:
        self.folder, self.asked = folder, asked
        self.at = Cursor(asked.wanted.begin)
        self.known: set[bytes] = set()
        self.taken: Count = 0
        self.is_whole = False
        self.damage = ""
        self._pieces = 0
        self._working = threading.RLock()

    @classmethod
    def new(cls, parent: Path, asked: AskedFetch) -> FetchSpool:
        """Make a folder; raises OSError."""
        folder = parent / f".{asked.name}{SPOOL}"
        make_folder(parent, 0o700)
        folder.mkdir(0o700)
        replace_file(folder / _ASKED, msgspec.json.encode(asked))
        return cls(folder, asked)

    @classmethod
    def load(cls, folder: Path, stop: Callable[[], bool]) -> FetchSpool | None:
        """Return the fetch of a folder with the pieces that are whole, or None if it is none, or told to stop."""
        try:
            asked = msgspec.json.decode((folder / _ASKED).read_bytes(), type=AskedFetch)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            return None
        spool = cls(folder, asked)
        try:
            for data in spool._read():
                if stop():
                    return None
                spool._count(decode_piece(data), len(data))
        except (PieceError, OSError):  # the disk has lost a part of it: it is got again
            pass
        return spool

    def _read(self) -> Iterator[bytes]:
        for number in count(1):
            if not (path := self._path(number)).exists():
                return
            yield path.read_bytes()

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:08}{_PIECE}"

    def _count(self, piece: Piece, size: int) -> None:
        check_follows(piece, self.at)
        self.known.update(piece.content().channels)
        if len(self.known) > MOST_CHANNELS:
            raise PieceError(PieceProblem.TOO_MANY_CHANNELS(most=MOST_CHANNELS))
        self.at, self.is_whole, self.damage = piece.end, piece.is_last, piece.damage
        self.taken += size
        self._pieces += 1

    def add(self, piece: Piece, data: bytes) -> None:
        """Keep a piece. One that a power cut takes is missed by its hash, and got again: no piece waits for the disk.

        Raises:
            PieceError: it is not the next one, or holds what no recording has.
            OSError: it cannot be written.
        """
        if self.taken > _TIMES_LARGER * self.asked.listed.size + _MORE:
            raise PieceError(SpoolProblem.TOO_MUCH())
        with self._working:
            self._check_room()
            check_follows(piece, self.at)
            self._path(self._pieces + 1).write_bytes(data)
            self._count(piece, len(data))

    def _check_room(self, wanted: int = 0) -> None:
        """Raise OSError if so many bytes leave less than has to stay free."""
        if shutil.disk_usage(self.folder).free < _LEFT_FREE + wanted:
            problem = SpoolProblem.DISK_FULL(folder=self.folder.parent, least=(_LEFT_FREE + wanted) / 1e9)
            raise OSError(errno.ENOSPC, problem)

    def messages(self) -> Iterator[StoredMessage]:
        """Yield all messages of the pieces, in their order; raises `PieceError`, OSError."""
        wanted = self.asked.wanted
        joiner = Joiner(wanted.topics, wanted.begin, wanted.end)
        for data in islice(self._read(), self._pieces):
            self._check_room()
            yield from joiner.add(decode_piece(data).content())
        joiner.finish()

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
            return self._write(stop)

    def _write(self, stop: Callable[[], bool]) -> int:
        path = self.path
        path.with_name(f".{path.name}{UNFINISHED}").unlink(missing_ok=True)  # of a bridge that was killed
        if is_there(path) and (count := self._written()):
            self.remove()
            return count
        self._check_room(self.taken)
        with new_recording(path) as recording:
            for message in self.messages():
                recording.copy(message)
                if stop():
                    raise InterruptedError
        self.remove()
        return recording.messages

    def _written(self) -> int:
        """Return how many messages the file has if it has all: a bridge was killed before it removed the pieces."""
        try:
            count = summary_of(self.path).messages
        except RecordingError:
            return 0
        return count if count == sum(1 for _ in self.messages()) else 0

    @property
    def path(self) -> Path:
        return self.folder.parent / f"{self.asked.name}.mcap"

    def remove(self) -> None:
        with self._working:
            shutil.rmtree(self.folder, ignore_errors=True)
