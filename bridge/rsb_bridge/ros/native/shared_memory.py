"""The ports in shared memory at which Fast DDS hears the nodes of this machine.

If a process stands still for more than a second (SIGSTOP, a debugger, a machine that is too busy), a sender may put
another file in its port's place. The process should follow, but Fast DDS 2.14.5 sometimes stays at the old one
(bench/README.md, *Stopped processes*). Then it hears no message of that sender any more, not even with new
subscriptions. DDS shows all as matched nevertheless, since discovery goes by UDP.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from rsb_bridge.ros.ros_interface import LostPort

_LOCK = re.compile(r"(/dev/shm/fast(?:rtps|dds)_port\d+)_el(?: \(deleted\))?")
"""Of a port that this process reads, it keeps this file open; of a port that it sends to, it only maps the memory."""
_MAPPED = re.compile(r"(\d+) +(/dev/shm/fast(?:rtps|dds)_port\d+)( \(deleted\))?\n")


def lost_ports() -> frozenset[LostPort]:
    """Return the ports that this process reads at a file that senders no longer open."""
    own = {found[1] for path in _open_files() if (found := _LOCK.fullmatch(path))}
    if not own:
        return frozenset()
    mapped = _MAPPED.findall(Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace"))
    # A process that has followed may have the old file mapped, too.
    followed = {port for _, port, deleted in mapped if not deleted}
    return frozenset(LostPort(port, int(inode)) for inode, port, _ in mapped if port in own - followed)


def _open_files() -> list[str]:
    found = []
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile, as that of the listing
            found.append(str(each.readlink()))
    return found
