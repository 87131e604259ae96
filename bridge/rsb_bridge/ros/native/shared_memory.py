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
_MAPPED = re.compile(r".* (\d+) +(/dev/shm/fast(?:rtps|dds)_port\d+)( \(deleted\))?")


class ReadPorts:
    """The ports that this process reads."""

    def __init__(self) -> None:
        self._well: dict[str, int] = {}  # inodes by port, if the last whole look found all well

    def lost(self) -> frozenset[LostPort]:
        """Return the ports whose present file senders no longer open."""
        # A whole look takes several ms, of which messages would have to wait for the end.
        if self._well and all(_inode(port) == inode for port, inode in self._well.items()):
            return frozenset()
        own = {found[1] for path in _open_files() if (found := _LOCK.fullmatch(path))}
        mapped = _mapped_ports() if own else []
        # A process that has followed may have the old file mapped, too.
        followed = {port: inode for port, inode, deleted in mapped if port in own and not deleted}
        lost = frozenset(LostPort(port, inode) for port, inode, _ in mapped if port in own - followed.keys())
        self._well = {} if lost else followed
        return lost


def _inode(port: str) -> int:
    try:
        return Path(port).stat().st_ino
    except FileNotFoundError:
        return 0


def _open_files() -> list[str]:
    found = []
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile, as that of the listing
            found.append(str(each.readlink()))
    return found


def _mapped_ports() -> list[tuple[str, int, bool]]:
    """Return each mapped port with its file's inode, and whether that file has been deleted."""
    lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    found = [_MAPPED.fullmatch(line) for line in lines if "_port" in line]
    return [(each[2], int(each[1]), bool(each[3])) for each in found if each]
