"""The files of one bridge: its events as lines of JSON, its time line as compressed MessagePack."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

import msgspec
import zstandard

from rsb_bridge.config.files import replace_file
from rsb_bridge.history.timeline import FROM_THE_FUTURE, VERSION, Saved, Timeline
from rsb_bridge.model.history import KEPT_FOR
from rsb_bridge.model.snapshot import Event
from rsb_bridge.model.text import sanitize_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from rsb_bridge.history.state_folder import Files
    from rsb_bridge.model.history import HistoryReport

FILE_BYTES = 2 << 20
FILES = 5
"""Files kept: the newest, and older ones with a number, ``NAME.1.jsonl`` and so on."""
_TEXT_LENGTH = 2000

_EMPTY = ("", None, False)
_line = msgspec.json.Decoder(dict[str, object])
_FILE_BYTES = 64 << 20
_BYTES = 256 << 20
_LEVEL = 1


class EventFile:
    """Appends events to a file, and begins a new one when it is full. The oldest one goes.

    Args:
        path: of the newest file; its folder exists.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd: int | None = None
        self._size = 0

    def write(self, events: Sequence[Event]) -> None:
        """Append all of them, or none.

        Raises:
            OSError: they cannot be written.
        """
        data = b"".join(encode_event(event) for event in events)
        if self._fd is not None and not self._is_there():
            self.close()
        if self._fd is None:
            self._open()
        if self._size and self._size + len(data) > FILE_BYTES:
            self.close()
            self._rotate()
            self._open()
        assert self._fd is not None
        written = 0
        try:
            while written < len(data):
                written += os.write(self._fd, data[written:])
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self._size)  # no half lines
            self.close()
            raise
        self._size += written

    def close(self) -> None:
        """Close the file; the next `write` opens it again."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def _is_there(self) -> bool:
        """Whether the open file is still the one at the path; an operator may have removed it."""
        assert self._fd is not None
        with contextlib.suppress(OSError):
            return os.path.samestat(os.fstat(self._fd), self.path.stat())
        return False

    def _open(self) -> None:
        fd = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.fchmod(fd, 0o600)  # one of before may be open to others
            self._size = os.fstat(fd).st_size
            if self._size and os.pread(fd, 1, self._size - 1) != b"\n":  # a line that a killed process began
                self._size += os.write(fd, b"\n")
        except OSError:
            os.close(fd)
            raise
        self._fd = fd

    def _rotate(self) -> None:
        for number in range(FILES - 1, 0, -1):
            newer = numbered(self.path, number - 1)
            with contextlib.suppress(FileNotFoundError):
                newer.replace(numbered(self.path, number))


def numbered(path: Path, number: int) -> Path:
    """An older file of events; number 0 is the newest."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def encode_event(event: Event) -> bytes:
    """An event as one line, with the keys of ``--log-format json``; what is empty is left out."""
    fields = msgspec.to_builtins(event).items()
    line = {name: _sanitized(name, value) for name, value in fields if value not in _EMPTY and name != "number"}
    return msgspec.json.encode({**line, "source": event.source}) + b"\n"


def _sanitized(name: str, value: object) -> object:
    if not isinstance(value, str):
        return value
    return sanitize_text(value, _TEXT_LENGTH) if name == "text" else sanitize_text(value)


def read_events(path: Path, since: float) -> Iterator[Event]:
    """The events in the files, oldest first; what is no event is left out.

    Args:
        path: of the newest file.
        since: no older ones, s since the epoch.
    """
    for number in range(FILES - 1, -1, -1):
        with contextlib.suppress(OSError), numbered(path, number).open("rb") as file:
            for line in file:
                with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                    event = msgspec.convert({**_line.decode(line), "number": 0}, Event)
                    if event.time >= since:
                        yield event


class HistoryFileError(Exception):
    """The file cannot be used; the message says why."""


class _Versioned(msgspec.Struct):
    version: int


def write_history(path: Path, saved: Saved) -> None:
    """Replace the file, atomically.

    Raises:
        OSError: it cannot be written.
    """
    packed = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(msgspec.msgpack.encode(saved))
    replace_file(path, packed)


def read_history(path: Path) -> Saved:
    """The content of the file.

    Raises:
        FileNotFoundError: there is none.
        HistoryFileError: it is not one of this version, or it cannot be read.
    """
    try:
        with path.open("rb") as file:
            packed = file.read(_FILE_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(path) from None
    except OSError as error:
        raise HistoryFileError(error.strerror or str(error)) from None
    if len(packed) > _FILE_BYTES:
        raise HistoryFileError("it is too large")
    try:
        if zstandard.frame_content_size(packed) > _BYTES:  # it is taken at its word, and so much memory is allocated
            raise HistoryFileError("it is too large")
        content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=_BYTES)
        version = msgspec.msgpack.decode(content, type=_Versioned).version
        if version != VERSION:
            age = "an older" if version < VERSION else "a newer"
            raise HistoryFileError(f"it is of {age} version of rsb-console")
        return msgspec.msgpack.decode(content, type=Saved)
    except (zstandard.ZstdError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise HistoryFileError(f"it is damaged ({error})") from None


def report(files: Files, now: float, seconds: float) -> HistoryReport:
    """What happened in the last so many s.

    Args:
        files: of the bridge.
        now: s since the epoch.
        seconds: 24 h at most.

    Raises:
        HistoryFileError: there is no time line, or none that can be used.
    """
    try:
        saved = read_history(files.history)
        timeline = Timeline.restore(saved, saved.name, saved.role)
    except FileNotFoundError:
        raise HistoryFileError(f"{files.history}: there is no such file") from None
    except (HistoryFileError, ValueError) as error:
        raise HistoryFileError(f"{files.history}: {error}") from None
    if saved.time - now > KEPT_FOR:
        raise HistoryFileError(f"{files.history}: {FROM_THE_FUTURE}")
    end = max(now, saved.time)
    timeline.go_on(event for event in read_events(files.events, saved.time) if event.time <= end)
    return timeline.report(end, seconds, running=False)
