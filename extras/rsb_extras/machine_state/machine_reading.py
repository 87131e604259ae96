"""Reads the figures of this machine: of /proc (proc(5)), of the mounted file systems, and of the kernel's sensors."""

from __future__ import annotations

import contextlib
import os
import re
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import in_thread, sanitize_text
from rsb_extras.machine_state.machine_figures import MEGABYTE, PATH_LENGTH, MachineState

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Context

EVERY = 5.0
"""s between two readings, and so between two messages of a link."""
_COUNTS_FOR = 3 * EVERY
"""s for which an earlier reading of the processors may serve for their use; then they have done something else."""
_ON_DEVICES = ("overlay", "zfs")
"""Types of file systems on disks whose source is no path of a device."""
_IN_MEMORY = ("/tmp", "/dev/shm")  # noqa: S108 -- looked at only
"""Mount points of file systems in memory that stop programs when they are full."""
_ESCAPED = re.compile(r"\\([0-7]{3})")
_PLAUSIBLE = range(-50, 200)
"""°C; sensors that are not connected give others."""


class _Processors(NamedTuple):
    busy: int  # ticks of all processors since the start
    all: int


class _Disk(NamedTuple):
    used: int = 0  # percent
    free: int = 0  # bytes
    path: str = ""


class MachineWatch:
    """Reads this machine's figures for all links of an engine, on a thread, while a link asks.

    Attributes:
        newest: the last figures, or None before the first.
        number: of readings so far.
    """

    def __init__(self, context: Context) -> None:
        self.newest: MachineState | None = None
        self.number = 0
        self._context = context
        self._at = -inf
        self._reading: asyncio.Task[None] | None = None
        self._processors: _Processors | None = None

    def look(self) -> None:
        """Begin a reading if the last one is 5 s old."""
        now = self._context.now()
        if (self._reading is not None and not self._reading.done()) or now - self._at < EVERY:
            return
        before = self._processors if now - self._at < _COUNTS_FOR else None
        self._at = now
        self._reading = self._context.loop.create_task(self._read(before))

    async def _read(self, before: _Processors | None) -> None:
        with contextlib.suppress(OSError, ValueError, LookupError):  # without /proc there are no figures
            # For as long as it takes: a disk that hangs keeps one thread, and not another one with each reading.
            self.newest, self._processors = await in_thread("machine", partial(read_machine, before), inf)
            self.number += 1


def read_machine(before: _Processors | None, root: Path = Path("/")) -> tuple[MachineState, _Processors]:
    """Return the figures of this machine, and its processors' counts for the next reading.

    Args:
        before: the counts of the last reading, or None.
        root: the folder that has ``proc`` and ``sys``.

    Raises:
        OSError: the kernel does not give a figure that every Linux has.
        ValueError: the same, of its form.
    """
    processors = _processors(root)
    total, available = _memory(root)
    disk = max(_disks(root), default=_Disk())
    state = MachineState(
        cores=os.cpu_count() or 1,
        load=float((root / "proc/loadavg").read_text(encoding="ascii").split()[0]),
        memory=_percent(total - available, total),
        memory_mb=total // MEGABYTE,
        cpu=None if before is None else _percent(processors.busy - before.busy, processors.all - before.all),
        disk=disk.used,
        disk_mb=disk.free // MEGABYTE,
        disk_path=sanitize_text(disk.path, PATH_LENGTH),
        temperature=max(_temperatures(root), default=None),
    )
    return state, processors


def _percent(part: int, whole: int) -> int:
    return min(100, max(0, 100 * part // whole)) if whole > 0 else 0


def _processors(root: Path) -> _Processors:
    line = (root / "proc/stat").read_text(encoding="ascii").partition("\n")[0]
    user, nice, system, idle, waiting, *others = (int(each) for each in line.split()[1:9])  # guests are in user
    busy = user + nice + system + sum(others)
    return _Processors(busy, busy + idle + waiting)


def _memory(root: Path) -> tuple[int, int]:
    """Return the bytes of all memory, and of what programs may still get."""
    lines = (root / "proc/meminfo").read_text(encoding="ascii").splitlines()
    found = dict(line.split(":", 1) for line in lines)
    total, available = (int(found[name].split()[0]) * 1024 for name in ("MemTotal", "MemAvailable"))
    return total, available


def _disks(root: Path) -> Iterator[_Disk]:
    """Yield the file systems that this machine writes to. None is on a network: that could keep the reader waiting."""
    for line in (root / "proc/self/mounts").read_text(encoding="utf-8", errors="replace").splitlines():
        source, path, kind, options, *_ = map(_unescaped, line.split(" "))
        is_disk = source.startswith("/dev/") or kind in _ON_DEVICES or path in _IN_MEMORY
        if not is_disk or "rw" not in options.split(","):
            continue
        try:
            status = os.statvfs(path)
        except OSError:  # of another user, or unmounted meanwhile
            continue
        if status.f_blocks and Path(path).is_dir():  # containers have single files mounted
            size, free = status.f_blocks * status.f_frsize, status.f_bavail * status.f_frsize
            used = _percent(size - free, size)
            if status.f_files:
                used = max(used, _percent(status.f_files - status.f_favail, status.f_files))
            yield _Disk(used, free, path)


def _unescaped(field: str) -> str:
    return _ESCAPED.sub(lambda octal: chr(int(octal[1], 8)), field)


def _temperatures(root: Path) -> Iterator[int]:
    for sensor in root.glob("sys/class/thermal/thermal_zone*/temp"):
        try:
            found = int(sensor.read_text(encoding="ascii")) // 1000
        except (OSError, ValueError):  # a sensor that is switched off
            continue
        if found in _PLAUSIBLE:
            yield found
