"""The history on disk: events as lines of JSON, the time line as compressed MessagePack."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import TYPE_CHECKING

import msgspec
import zstandard

from rsb_bridge.config.files import owner_only
from rsb_bridge.config.folder_owner import acting_in_folder
from rsb_bridge.feature_api import Event, Level, file_stem, replace_file, why_not_written
from rsb_bridge.model.limits import TIME
from rsb_extras.history.bridge_files import Claim, Files
from rsb_extras.history.history_codes import HistoryCode
from rsb_extras.history.recorder import SET_WITHIN
from rsb_extras.history.timeline import FROM_THE_FUTURE, VERSION, Saved, Timeline, is_from_the_future

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Clock, EventLog
    from rsb_extras.history.history_data import HistoryReport
    from rsb_extras.history.recorder import Recorder

FILE_BYTES = 2 << 20
"""Bytes; not measured. All files together have room for tens of thousands of usual events."""
FILES = 5
"""Files kept: the newest, and older ones with a number, ``NAME.1.jsonl`` and so on."""
_EMPTY = ("", None, False)
_line = msgspec.json.Decoder(dict[str, object])
_FILE_BYTES = 64 << 20
"""Of the packed time line. That of 500 topics has 0.4 MB (bench/README)."""
_BYTES = 256 << 20
"""Of the unpacked one. That of all tracks that are kept has 21 MB for 24 h, outages and actions apart."""
_LEVEL = 1
"""Of zstd, the lowest usual one: the file is packed as a whole at each save."""


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
        # A batch that is longer than a file goes into an empty one all the same.
        if self._size and self._size + len(data) > FILE_BYTES:
            self.close()
            self._rotate()
            self._open()
        assert self._fd is not None
        written = 0
        try:
            # A disk that becomes full takes a part of it.
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
        fd = owner_only(str(self.path), os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC)
        try:
            self._size = os.fstat(fd).st_size
            if self._size and os.pread(fd, 1, self._size - 1) != b"\n":  # a line that a killed process began
                self._size += os.write(fd, b"\n")
        except OSError:
            os.close(fd)
            raise
        self._fd = fd

    def _rotate(self) -> None:
        with acting_in_folder(self.path):
            for number in range(FILES - 1, 0, -1):
                newer = numbered(self.path, number - 1)
                with contextlib.suppress(FileNotFoundError):
                    newer.replace(numbered(self.path, number))


def numbered(path: Path, number: int) -> Path:
    """Return an older file of events; number 0 is the newest."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def encode_event(event: Event) -> bytes:
    """Return an event as one line, with the keys of ``--log-format json``; what is empty is left out.

    Its texts come from a log, which has made them clean and short.
    """
    fields = msgspec.to_builtins(event).items()
    line = {name: value for name, value in fields if value not in _EMPTY and name != "number"}
    return msgspec.json.encode({**line, "source": event.source}) + b"\n"


def read_events(path: Path, since: float) -> Iterator[Event]:
    """Yield the events in the files, oldest first; what is no event is left out.

    Args:
        path: of the newest file.
        since: no older ones, s since the epoch.
    """
    for number in range(FILES - 1, -1, -1):
        with contextlib.suppress(OSError), numbered(path, number).open("rb") as file:
            for line in file:
                with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                    # Numbers count in one process only, so the files have none.
                    event = msgspec.convert({**_line.decode(line), "number": 0}, Event)
                    if event.time >= since and _is_dated(event):
                        yield event


def _is_dated(event: Event) -> bool:
    return event.time in TIME and (event.since is None or event.since in TIME)


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
    """Read a time line from its file.

    Raises:
        FileNotFoundError: the file does not exist.
        HistoryFileError: the file is damaged, of another version, or cannot be read.
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
        # The limit counts for a file that does not announce its size; for others it is ignored.
        content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=_BYTES)
        # First: the rest of another version's file may have any form.
        version = msgspec.msgpack.decode(content, type=_Versioned).version
        if version != VERSION:
            raise HistoryFileError("it was written by another version of rsb-console")
        saved = msgspec.msgpack.decode(content, type=Saved)
    except (zstandard.ZstdError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise HistoryFileError(f"it is damaged ({error})") from None
    if not all(map(_is_dated, saved.actions)):
        raise HistoryFileError("it is damaged (an event has an impossible time)")
    return saved


def report(files: Files, now: float, seconds: float) -> HistoryReport:
    """Report on the last `seconds` from the files of a bridge that does not run.

    Args:
        now: s since the epoch.
        seconds: 24 h at most.

    Raises:
        HistoryFileError: the time line is missing or cannot be used.
    """
    try:
        saved = read_history(files.history)
        timeline = Timeline.restore(saved, saved.name, saved.role)
    except FileNotFoundError:
        raise HistoryFileError(f"{files.history}: there is no such file") from None
    except (HistoryFileError, ValueError) as error:
        raise HistoryFileError(f"{files.history}: {error}") from None
    if is_from_the_future(saved, now):
        raise HistoryFileError(f"{files.history}: {FROM_THE_FUTURE}")
    # The clock may have been set back since, up to a day.
    end = max(now, saved.time)
    timeline.go_on(event for event in read_events(files.events, saved.time) if event.time <= end)
    return timeline.report(end, seconds, running=False)


_EVERY = 0.5
"""s from one write to the next; all events in between are written together. A round figure."""
_LOOKS_EVERY = 2.0
"""s after which it looks whether the time line is due, if there is no event before. A round figure."""
_RETRIED_EVERY = 5.0
"""s from one try to the next while the disk takes nothing. A round figure."""
SAVED_EVERY = 120.0
"""s from one save to the next while nothing happens; not measured. A killed process loses the rates since then."""
_SAVED_SOON = 5.0
"""s from one save to the next where an outage has begun or ended, or an operator did something. A round
figure."""
_ANSWERED_WITHIN = 10.0
"""s for an answer of the recorder's thread: at most 0.26 s in bench/README."""
SET_ASIDE = ".bad"


class Disk:
    """Writes an engine's events and a recorder's time line to disk, from `start` to `stop`.

    A failure is reported once, as an event. Until writing works again, the events wait in the engine's log, which keeps
    a limited number.

    Args:
        recorder: has the time line; goes on from the file that an earlier process left.
    """

    def __init__(self, folder: Path, name: str, role: str, events: EventLog, recorder: Recorder, clock: Clock) -> None:
        self._folder, self._name, self._role = folder, name, role
        self._events = events
        self._recorder = recorder
        self._clock = clock
        self._claim: Claim | None = None
        self._file: EventFile | None = None
        self._written = 0
        self._is_restored = False
        self._left: tuple[Saved, tuple[Event, ...]] | None = None  # by the last process, until it is restored
        self._began = clock.steady()
        self._saved_at = self._tried_at = float("-inf")
        self._saved_changes = 0
        self._trouble = ""
        self._missing = 0
        self._ends = threading.Event()
        # A daemon, and `stop` waits for a time only: a disk that never answers (NFS) must not keep the process.
        self._thread = threading.Thread(target=self._run, name="rsb-disk", daemon=True)

    def start(self) -> None:
        """Begin: restore the time line, and write."""
        self._thread.start()

    def stop(self, timeout: float) -> None:
        """Write the last events and the time line; the recorder has stopped."""
        self._ends.set()
        self._events.wake()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        while not self._ends.is_set():
            written = self._written
            self.turn()
            if self._trouble or written != self._written:
                self._ends.wait(_EVERY)  # a fixed pause, so that several events are written together
            else:
                pause = _EVERY if self._is_changed else _LOOKS_EVERY
                self._events.wait(self._written, pause, self._ends.is_set)
        # The last turn tries even if one has failed a moment ago.
        self._tried_at = float("-inf")
        self.turn(last=True)
        if self._file is not None:
            self._file.close()
        if self._claim is not None:
            self._claim.close()

    def turn(self, *, last: bool = False) -> None:
        """Write what is due.

        Args:
            last: nothing comes after it.
        """
        now = self._clock.steady()
        if self._trouble and now - self._tried_at < _RETRIED_EVERY:
            return
        self._tried_at = now
        try:
            if self._claim is None:
                self._open()
            self._restore()
            self._write_events()
            if self._is_restored and (last or self._is_due(now)):
                self._save(now)
        except (OSError, ValueError) as error:
            self._failed(why_not_written(error, self._folder) if isinstance(error, OSError) else str(error))
            self._restore()
        else:
            self._works()

    # --- files

    def _open(self) -> None:
        self._claim = Claim(self._folder, self._name, self._role)
        self._file = EventFile(self._claim.files.events)

    @property
    def _files(self) -> Files:
        return Files(self._folder, file_stem(self._name)) if self._claim is None else self._claim.files

    def _restore(self) -> None:
        """Once: have the recorder go on from what is in the file, even where it cannot be replaced now."""
        if self._is_restored:
            return
        path = self._files.history
        try:
            if self._left is None:
                saved = read_history(path)
                self._left = saved, tuple(read_events(self._files.events, saved.time))  # before ours are among them
            saved, events = self._left
            now, wall = self._clock.steady(), self._clock.time_ns() / 1e9
            if is_from_the_future(saved, wall) and now - self._began < SET_WITHIN:
                return
            self._recorder.ask(lambda: self._recorder.restore(saved, events)).result(_ANSWERED_WITHIN)
        except TimeoutError:  # of the recorder, but an OSError, which `turn` would take for the disk's
            return
        except FileNotFoundError:
            pass
        except (HistoryFileError, ValueError) as error:
            aside = path.with_name(path.name + SET_ASIDE)
            with contextlib.suppress(OSError):  # then the first save replaces it, or says why it cannot
                path.replace(aside)
            text = f"{path}: {error}. It is set aside as {aside.name}, and a new time line begins"
            self._events.add(Level.WARNING, HistoryCode.SET_ASIDE, text)
        self._is_restored, self._left = True, None

    def _write_events(self) -> None:
        events = self._events.after(self._written)
        if not events:
            return
        assert self._file is not None
        self._file.write([event for event in events if event.level is not Level.DEBUG])
        self._missing += events[0].number - self._written - 1
        self._written = events[-1].number

    @property
    def _is_changed(self) -> bool:
        return self._recorder.changes != self._saved_changes

    def _is_due(self, now: float) -> bool:
        return now - self._saved_at >= (_SAVED_SOON if self._is_changed else SAVED_EVERY)

    def _save(self, now: float) -> None:
        # Before the question: what happens during the save is saved by the next one.
        changes = self._recorder.changes
        with contextlib.suppress(TimeoutError):  # as in `_restore`
            saved = self._recorder.ask(self._recorder.save).result(_ANSWERED_WITHIN)
            write_history(self._files.history, saved)
            # Only now: a save that failed stays due, so that the next turn tries it before it says that all is well.
            self._saved_at, self._saved_changes = now, changes

    # --- failures

    def _failed(self, reason: str) -> None:
        if not self._trouble:
            text = f"{self._folder}: {reason}. Events and the time line are not kept on disk; the bridge goes on"
            self._trouble = reason
            self._events.add(Level.WARNING, HistoryCode.FILE_FAILED, text)

    def _works(self) -> None:
        if self._trouble:
            self._trouble = ""
            missing = f"; {self._missing:,} events are missing" if self._missing else ""
            self._missing = 0
            text = f"{self._folder}: events and the time line are kept on disk again{missing}"
            self._events.add(Level.INFO, HistoryCode.FILE_AGAIN, text)
