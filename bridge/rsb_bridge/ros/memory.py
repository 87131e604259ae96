"""Memory of large messages: what DDS's histories and the heap keep of it, and when it goes back to the kernel."""

from __future__ import annotations

import ctypes
import re
import sys
import threading
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rsb_bridge.ros.environment import with_variables

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, MutableMapping

PROFILE_VARIABLES = _OLD, _NEW = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
"""Fast DDS 2, until Jazzy, knows the first one only; rmw_fastrtps warns of it where it knows the second one."""
HISTORIES = {
    variable: Path(__file__).with_name(f"fast_dds_{version}_histories.xml")
    for version, variable in enumerate(PROFILE_VARIABLES, start=2)
}
LARGE_MESSAGES = {_OLD: "fastdds-large-messages.xml", _NEW: "fastdds3-large-messages.xml"}
"""Names of the profiles for users, in `configs`: Fast DDS refuses the whole file if an element has the other's name."""
_PROMPT_WRITER = '<data_writer profile_name="prompt_writer">.*?</data_writer>'
_QOS_VARIABLE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
_FAST_DDS_2 = "libfastrtps.so"
_FOUND_BY_FAST_DDS = Path("DEFAULT_FASTRTPS_PROFILES.xml"), Path("DEFAULT_FASTDDS_PROFILES.xml")
"""Files in the working directory, which Fast DDS loads by itself."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST_ON_HEAP = 32 << 20
"""Bytes of a block that comes from the heap; it is the most that glibc allows."""
_MOST_FREE_HEAP = 64 << 20
"""Bytes that may be free at the end of each of the heap's arenas, until they go back: ten messages of 6 MB."""
_LITTLE_FREE_HEAP = 8 << 20
"""Bytes that may stay free. A round figure: one message of 6 MB comes and goes without the kernel."""
_HEAP_TRIMMED_EVERY = 8.0
"""Seconds between trims. A trim of 60 MB costs 10 ms, and as much to grow again."""


@contextmanager
def histories_that_shrink(environment: MutableMapping[str, str]) -> Iterator[bool]:
    """Have the participant that the context creates free what its writers held. A user's own profiles have priority.

    Yields whether the profiles are the bridge's.

    rmw_fastrtps has Fast DDS reuse the memory of each message in a history for the next one, enlarged to the largest
    that it ever held. So 300 messages of 1 MB keep 180 MB for as long as the topic lasts. With the policy ``DYNAMIC`` a
    message's memory is freed with it; only an XML profile can ask for that, and only `_QOS_VARIABLE` makes it count.
    Other middlewares ignore the variables. They are removed again, since children of this process inherit what stays.

    A reader must not free messages: after a writer of another DDS has withdrawn a message of which parts had come, Fast
    DDS (2.14.5) still reads the message, and the process may crash. ``DYNAMIC_REUSABLE`` keeps the memory, but
    allocates nothing before it is needed.
    """
    if any(name in environment for name in (*PROFILE_VARIABLES, _QOS_VARIABLE)) or any(
        path.exists() for path in _FOUND_BY_FAST_DDS
    ):
        yield False
        return
    variable = profile_variable(environment)
    with with_variables(environment, {variable: str(HISTORIES[variable]), _QOS_VARIABLE: "1"}):
        yield True


@cache
def prompt_writer(variable: str) -> str:
    """Return the XML of the profile `prompt_writer` alone, to be given the name of a topic instead.

    Args:
        variable: as `profile_variable` names it.
    """
    text = HISTORIES[variable].read_text(encoding="utf-8")
    head, profile = re.search(r"<profiles .*?>", text), re.search(_PROMPT_WRITER, text, re.DOTALL)
    assert head is not None
    assert profile is not None
    return f"{head[0]}{profile[0]}</profiles>"


def profile_variable(environment: Mapping[str, str]) -> str:
    """Return the name of the environment variable in which Fast DDS finds the path of its profiles."""
    prefixes = (*environment.get("AMENT_PREFIX_PATH", "").split(":"), sys.prefix)
    return _OLD if any(prefix and Path(prefix, "lib", _FAST_DDS_2).exists() for prefix in prefixes) else _NEW


def profile_for_large(environment: Mapping[str, str]) -> tuple[str, str]:
    """Return that variable's name, and the name of the file in `configs` for it."""
    variable = profile_variable(environment)
    return variable, LARGE_MESSAGES[variable]


class _Statistics(ctypes.Structure):
    """A mallinfo2 (malloc.h)."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "free", "keep")
    )


@contextmanager
def large_blocks_kept() -> Iterator[None]:
    """Keep large blocks on the heap for as long as the context lasts. With a C library other than glibc, do nothing.

    By itself glibc gives the memory of a large message back to the kernel as soon as it is free, and gets new pages for
    the next one: hundreds of page faults a message, which cost more than to seal it. So large blocks come from the heap
    here, and what is free of it goes back within 8 s.
    """
    library = ctypes.CDLL(None)
    if not all(hasattr(library, name) for name in ("mallopt", "mallinfo2", "malloc_trim")):
        yield
        return
    library.mallinfo2.restype = _Statistics
    library.mallopt(_M_MMAP_THRESHOLD, _LARGEST_ON_HEAP)
    library.mallopt(_M_TRIM_THRESHOLD, _MOST_FREE_HEAP)
    ended = threading.Event()
    giving_back = threading.Thread(target=_give_back, args=(library, ended), name="heap", daemon=True)
    giving_back.start()
    try:
        yield
    finally:
        ended.set()
        giving_back.join()


def _give_back(library: Any, ended: threading.Event) -> None:
    """Return free memory to the system. Runs on its own thread, so that only threads that allocate wait for it."""
    while not ended.wait(_HEAP_TRIMMED_EVERY):
        if library.mallinfo2().free > _LITTLE_FREE_HEAP:
            library.malloc_trim(_LITTLE_FREE_HEAP)
