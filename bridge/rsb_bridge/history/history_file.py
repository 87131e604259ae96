"""The time line as a file: compressed MessagePack, replaced as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import zstandard

from rsb_bridge.config.files import replace_file
from rsb_bridge.history.timeline import VERSION, Saved

if TYPE_CHECKING:
    from pathlib import Path

_FILE_BYTES = 64 << 20
_BYTES = 256 << 20
_LEVEL = 1


class HistoryFileError(Exception):
    """The file cannot be used; the message says why."""


class _Versioned(msgspec.Struct):
    version: int


def write(path: Path, saved: Saved) -> None:
    """Replace the file, atomically.

    Raises:
        OSError: it cannot be written.
    """
    packed = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(msgspec.msgpack.encode(saved))
    replace_file(path, packed)


def read(path: Path) -> Saved:
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
