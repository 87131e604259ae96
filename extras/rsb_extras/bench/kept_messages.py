"""The messages of one run, as one end of a measured stream keeps them for a recording."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.cdr.known_types import stamped_string

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MOST_MESSAGES = 1_000_000
"""Messages of a run that are kept, 16 MB. A round figure: runs have at most some 100,000."""
MOST_FOREIGN = 64 << 20
"""Bytes of foreign messages that are kept. A round figure: there are none unless something alters messages."""


class KeptMessage(NamedTuple):
    """One message; times are in ns of the monotonic clock, which all processes of a machine share.

    Attributes:
        made: the stamp in it.
        time: when this end published it or heard it.
    """

    made: int
    time: int
    content: bytes


class KeptMessages:
    """Keeps two numbers for each message, from which it is made again: messages of 6 MB would not fit into memory.

    A message that `stamped_string` would not make is kept whole, so that a recording has what really arrived.

    Args:
        size: of the run's messages, as `stamped_string` takes it.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._made, self._times = array("Q"), array("Q")
        self._foreign: dict[int, bytes] = {}
        self._foreign_bytes = 0

    def add(self, made: int, time: int, content: bytes) -> None:
        """Keep a message, or none after the first that has no room."""
        number = len(self._times)
        if number >= MOST_MESSAGES or self._foreign_bytes > MOST_FOREIGN:
            return
        # Digits of a foreign message may be any time, also one that 64 bits cannot hold.
        if made > time or content != stamped_string(self._size, made):
            self._foreign_bytes += len(content)
            if self._foreign_bytes > MOST_FOREIGN:
                return
            self._foreign[number] = content
        self._made.append(min(made, time))
        self._times.append(time)

    def write(self, path: Path, count: int) -> bool:
        """Write the first `count` messages, or nothing if not all of them were kept. Return whether it is written.

        Raises:
            OSError: the file cannot be written.
        """
        if count > len(self._times):
            return False
        made, times = self._made[:count].tobytes(), self._times[:count].tobytes()
        # A copy, as another thread may still add to it.
        path.write_bytes(msgspec.msgpack.encode((self._size, made, times, self._foreign.copy())))
        return True


def write_made(path: Path, size: int, made: array[int]) -> None:
    """Write messages of `stamped_string` as their publisher has them, from their stamps alone.

    Raises:
        OSError: the file cannot be written.
    """
    stamps = made.tobytes()
    path.write_bytes(msgspec.msgpack.encode((size, stamps, stamps, {})))


def read_kept(path: Path) -> Iterator[KeptMessage]:
    """Yield the messages of a file, each made when it is asked for."""
    size, *columns, foreign = msgspec.msgpack.decode(path.read_bytes(), type=tuple[int, bytes, bytes, dict[int, bytes]])
    for number, (made, time) in enumerate(zip(*(array("Q", each) for each in columns), strict=True)):
        yield KeptMessage(made, time, foreign.get(number) or stamped_string(size, made))
