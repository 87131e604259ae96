"""Recordings as they lie on disk: a file, or the files of a folder of rosbag2, each of which is read once."""

from __future__ import annotations

import re
import sqlite3
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_extras.audit import mcap_records, sqlite_bag
from rsb_extras.audit.recorded import Damage, DamageError, ReadRecording, RecordingRows

if TYPE_CHECKING:
    from pathlib import Path
    from typing import IO

_NUMBER = re.compile(r"(.+)_\d+(\.mcap|\.db3)")  # of the files of a split bag
_ZSTD = b"\x28\xb5\x2f\xfd"


class UnreadableRecording(Wording):
    """Reasons why a recording cannot be read."""

    NOT_INSTALLED = "mcap is not installed: pip install 'rsb-console[record]'"
    NOT_THERE = "{path} cannot be read: {reason}"
    NO_RECORDING = "{path} is no recording: give a file *.mcap or *.db3 of `ros2 bag record`"
    NONE_WITHIN = "{path} has no file *.mcap or *.db3: give a folder of `ros2 bag record`"
    SEVERAL = "{path} has recordings of several names: give one of its files"
    COMPRESSED = "{path} is compressed as a whole: unpack it with `zstd -d`"
    EMPTY = "{path} has no message{cut}"
    NO_ROOM = "the folder for temporary files cannot hold the audit ({reason}): set TMPDIR to one with more room"


class RecordingError(Exception):
    """A recording cannot be read; the message says why, and what to do."""


def read_recording(path: Path, side: str, database: sqlite3.Connection) -> ReadRecording:
    """Read a file, or the files of a rosbag2 folder, into tables whose names begin with `side`.

    Raises:
        RecordingError: it is no recording, or has no message.
    """
    recording = ReadRecording(path, _files_of(path))
    rows = RecordingRows(recording, side, database)
    for file in recording.files:
        try:
            with file.open("rb") as opened:
                cut = _read(opened, file, rows)
        except OSError as error:
            raise RecordingError(UnreadableRecording.NOT_THERE(path=file, reason=error.strerror or error)) from None
        if cut:
            recording.cut = cut if file == path else f"{file.name}: {cut}"
    rows.write()
    if not recording.messages:
        raise RecordingError(UnreadableRecording.EMPTY(path=path, cut=recording.cut and f": {recording.cut}"))
    return recording


def _files_of(path: Path) -> list[Path]:
    try:
        if not path.is_dir():
            return [path]
        names = [each.name for each in path.iterdir()]
    except OSError as error:
        raise RecordingError(UnreadableRecording.NOT_THERE(path=path, reason=error.strerror)) from None
    if any(name.endswith((".mcap.zstd", ".db3.zstd")) for name in names):
        raise RecordingError(UnreadableRecording.COMPRESSED(path=path))
    found = [name for name in names if name.endswith((".mcap", ".db3"))]
    if not found:
        raise RecordingError(UnreadableRecording.NONE_WITHIN(path=path))
    numbered = {name: _NUMBER.fullmatch(name) for name in found}
    if len({match.groups() if match else name for name, match in numbered.items()}) > 1:
        raise RecordingError(UnreadableRecording.SEVERAL(path=path))
    return [path / name for name in sorted(found, key=lambda name: (len(name), name))]  # _10 behind _9


def _read(opened: IO[bytes], path: Path, rows: RecordingRows) -> str:
    """Read a file, and return why its end was not read, or an empty text."""
    magic = opened.read(len(mcap_records.MAGIC))
    is_sqlite = bool(magic) and sqlite_bag.MAGIC.startswith(magic)
    if magic.startswith(_ZSTD):
        raise RecordingError(UnreadableRecording.COMPRESSED(path=path))
    if not is_sqlite and not mcap_records.MAGIC.startswith(magic):
        raise RecordingError(UnreadableRecording.NO_RECORDING(path=path))
    if len(magic) < len(mcap_records.MAGIC):
        return Damage.BROKEN(kind=EOFError.__name__)
    try:
        if is_sqlite:
            sqlite_bag.read_sqlite(path, rows)
        else:
            import mcap.records  # noqa: F401, PLC0415 -- everything else does without

            mcap_records.read_mcap(opened, rows)
    except ImportError:
        raise RecordingError(UnreadableRecording.NOT_INSTALLED()) from None
    except (sqlite3.Error, OSError):
        raise
    except DamageError as error:
        return str(error)
    # What the libraries of MCAP, zstd and lz4 raise has no common class.
    except Exception as error:  # noqa: BLE001
        return Damage.BROKEN(kind=type(error).__name__)
    return ""
