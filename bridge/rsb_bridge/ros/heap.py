"""The memory that glibc keeps between large messages.

By itself glibc gives the memory of a large message back to the kernel as soon as it is free, and gets new pages for
the next one: hundreds of page faults a message, which cost more than to seal it. So large blocks come from the heap
here, and what is free of it goes back twice a minute.
"""

from __future__ import annotations

import ctypes
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST = 32 << 20
"""Bytes of a block that comes from the heap; it is the most that glibc allows."""
_MOST_FREE = 64 << 20
"""Bytes that may be free at the end of each of the heap's arenas, until they go back."""
_LITTLE = 8 << 20
"""Bytes that may stay free."""
_EVERY = 30.0
"""s; to give 60 MB back takes 10 ms, and to get them again as many."""


class _Statistics(ctypes.Structure):
    """A mallinfo2 (malloc.h)."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "free", "keep")
    )


@contextmanager
def large_blocks_kept() -> Iterator[None]:
    """Keep them for as long as the context lasts. With another C library than glibc nothing happens."""
    library = ctypes.CDLL(None)
    if not all(hasattr(library, name) for name in ("mallopt", "mallinfo2", "malloc_trim")):
        yield
        return
    library.mallinfo2.restype = _Statistics
    library.mallopt(_M_MMAP_THRESHOLD, _LARGEST)
    library.mallopt(_M_TRIM_THRESHOLD, _MOST_FREE)
    ended = threading.Event()
    giving_back = threading.Thread(target=_give_back, args=(library, ended), name="heap", daemon=True)
    giving_back.start()
    try:
        yield
    finally:
        ended.set()
        giving_back.join()


def _give_back(library: Any, ended: threading.Event) -> None:
    """On a thread of its own: it holds up nobody who needs no memory."""
    while not ended.wait(_EVERY):
        if library.mallinfo2().free > _LITTLE:
            library.malloc_trim(_LITTLE)
