"""Finds the processes of nodes on this machine, and reads their figures of /proc (proc(5))."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from rsb_bridge.feature_api import sanitize_text
from rsb_extras.nodes.node_data import MOST_PROCESSES, ProcessState

_FAST_DDS = b"\x01\x0f"
"""Vendor's id. Its GUIDs go on with two bytes of the host's id, and the lower two of the process's, as tests show."""
_HOST, _PID = slice(2, 4), slice(4, 6)
_PID_STEP = 1 << 16
_LIBRARIES = (b"fastrtps", b"fastdds")
_PROC = Path("/proc")
_TICKS = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")
_MEGABYTE = 10**6


class _Running(NamedTuple):
    """A process at a moment."""

    start: int  # ticks since the machine's start, which tells it from another one of its number
    used: int  # ticks of its processors
    memory: int  # pages
    threads: int
    name: str


class NodeProcesses:
    """The processes of nodes on this machine. For one thread.

    Args:
        own: GUID of an endpoint of this process, which tells how this machine is called there.
    """

    def __init__(self, own: bytes, proc: Path = _PROC) -> None:
        self._own = own
        self._proc = proc
        self._found: dict[bytes, tuple[int, int]] = {}  # pid and start, by participant; 0 where there is none here
        self._used: dict[int, tuple[int, float]] = {}  # ticks, and when they were read

    def machine_of(self, participant: bytes) -> str:
        """Return the machine of a participant, empty if its GUID does not tell it."""
        if participant[:2] != _FAST_DDS or self._own[:2] != _FAST_DDS:
            return ""
        if participant[_HOST] == self._own[_HOST]:
            return sanitize_text(os.uname().nodename, 64)
        return f"host {participant[_HOST].hex()}"

    def pid_of(self, participant: bytes) -> int:
        """Return the pid of a participant's process, or 0 if it is not known to be here."""
        if participant not in self._found:
            if len(self._found) >= 4 * MOST_PROCESSES:
                self._found.clear()
            self._found[participant] = self._find(participant)
        return self._found[participant][0]

    def has_ended(self, participant: bytes) -> bool:
        """Whether a participant's process was here and has gone, though DDS may still list it."""
        pid, start = self._found.get(participant, (0, 0))
        return pid != 0 and ((running := self._running(pid)) is None or running.start != start)

    def pid_by_name(self, names: set[str]) -> dict[str, int]:
        """Return the pids of nodes by their names in command lines; of those that several processes have, none."""
        found: dict[str, set[int]] = {}
        for pid in self._pids():
            for name in _named(self._command(pid)) & names:
                found.setdefault(name, set()).add(pid)
        return {name: pids.pop() for name, pids in found.items() if len(pids) == 1}

    def figures(self, pid: int, now: float) -> ProcessState | None:
        """Return the figures of a process, or None if it has ended. Its first ones have no use of processors.

        Args:
            now: s; the clock of `ProcessState.since`, too.
        """
        running = self._running(pid)
        if running is None:
            self._used.pop(pid, None)
            return None
        used, at = self._used.get(pid, (running.used, now))
        if now - at >= 1 or pid not in self._used:
            self._used[pid] = running.used, now
        cpu = 100 * (running.used - used) / _TICKS / (now - at) if now > at else 0.0
        since = now - (self._uptime() - running.start / _TICKS)
        return ProcessState(
            pid, running.name, max(0, round(cpu)), running.memory * _PAGE // _MEGABYTE, running.threads, round(since)
        )

    def _find(self, participant: bytes) -> tuple[int, int]:
        if participant[:4] != self._own[:4] or participant[:2] != _FAST_DDS:
            return 0, 0
        low = int.from_bytes(participant[_PID], "little")
        try:
            most = int((self._proc / "sys/kernel/pid_max").read_text(encoding="ascii"))
        except (OSError, ValueError):
            most = _PID_STEP
        candidates = [pid for pid in range(low, most + 1, _PID_STEP) if pid and self._may_be_node(pid)]
        if len(candidates) != 1 or (running := self._running(candidates[0])) is None:
            return 0, 0
        return candidates[0], running.start

    def _may_be_node(self, pid: int) -> bool:
        """Whether a process is known to have Fast DDS loaded."""
        try:
            maps = (self._proc / str(pid) / "maps").read_bytes()
        except OSError:  # of another user's, it may be any: the GUIDs of nodes in containers have pids from there
            return False
        return any(each in maps for each in _LIBRARIES)

    def _running(self, pid: int) -> _Running | None:
        try:
            text = (self._proc / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
            name, _, rest = text.partition("(")[2].rpartition(")")
            fields = rest.split()  # from the third on
            used, memory = int(fields[11]) + int(fields[12]), int(fields[21])
            return (
                None
                if fields[0] in "ZX"
                else _Running(int(fields[19]), used, memory, int(fields[17]), sanitize_text(name, 64))
            )
        except (OSError, ValueError, IndexError):
            return None

    def _uptime(self) -> float:
        return float((self._proc / "uptime").read_text(encoding="ascii").split()[0])

    def _pids(self) -> list[int]:
        return [int(each.name) for each in self._proc.iterdir() if each.name.isdigit()]

    def _command(self, pid: int) -> list[str]:
        try:
            content = (self._proc / str(pid) / "cmdline").read_bytes()
        except OSError:
            return []
        return content.decode("utf-8", "replace").rstrip("\0").split("\0") if content else []


def _named(command: list[str]) -> set[str]:
    """Return the nodes that a command line may run: by their names as `ros2 launch` gives them, or the program's."""
    given = dict(each.split(":=", 1) for each in command if each.startswith(("__node:=", "__name:=", "__ns:=")))
    name = given.get("__node", given.get("__name", ""))
    namespace = given.get("__ns", "").rstrip("/")
    if name:
        return {f"{namespace}/{name}"}
    programs = command[:1] if command and "python" not in command[0] else command[1:2]
    return {f"{namespace}/{Path(each).stem}" for each in programs}
