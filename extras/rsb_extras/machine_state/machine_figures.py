"""The figures of a machine: the message that crosses, what snapshots show, and what is wrong by them."""

from __future__ import annotations

from collections import Counter
from enum import StrEnum
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import PRINTABLE, ControlMessageBase, Count, ShownField, Wording

if TYPE_CHECKING:
    from collections.abc import Mapping

PATH_LENGTH = 64
MEGABYTE = 10**6

Percent: TypeAlias = Annotated[int, Meta(ge=0, le=100)]
Load: TypeAlias = Annotated[float, Meta(ge=0, le=1e6)]
Celsius: TypeAlias = Annotated[int, Meta(ge=-100, le=300)]
MountPoint: TypeAlias = Annotated[str, Meta(max_length=PATH_LENGTH, pattern=PRINTABLE)]


class MachineState(ControlMessageBase, frozen=True, omit_defaults=True):
    """A side's machine, every 5 s.

    Attributes:
        cpu: use of all processors in the last seconds, or None without a figure.
        load: the average of a minute, as `uptime` shows it.
        memory: share that is in use.
        memory_mb: all of it.
        disk: use of the fullest file system.
        disk_mb: free there.
        disk_path: its mount point.
        temperature: of the hottest sensor, or None without one.
    """

    cores: Count
    load: Load
    memory: Percent
    memory_mb: Count
    cpu: Percent | None = None
    disk: Percent = 0
    disk_mb: Count = 0
    disk_path: MountPoint = ""
    temperature: Celsius | None = None


class MachineCause(StrEnum):
    """The ways in which a machine is short of something."""

    CPU, MEMORY, DISK, HOT = "cpu", "memory", "disk", "hot"


class ShownMachine(msgspec.Struct, frozen=True):
    """The other side's machine, in snapshots; its fields are those of `MachineState`."""

    cores: Count
    load: Load
    memory: Percent
    memory_mb: Count
    cpu: Percent | None
    disk: Percent
    disk_mb: Count
    disk_path: MountPoint
    temperature: Celsius | None
    wrong: tuple[MachineCause, ...]


MACHINE: ShownField[ShownMachine | None] = ShownField("machine", ShownMachine | None, None)
"""The other side's machine; None while nothing is known of it."""


def shown(state: MachineState, wrong: tuple[MachineCause, ...]) -> ShownMachine:
    return ShownMachine(**msgspec.structs.asdict(state), wrong=wrong)


class MachineFault(Wording):
    """Sentences on a machine that is short of something, each with the remedy."""

    CPU = "its processors are at {cpu} %: end what takes them there (top)"
    MEMORY = "its memory is {memory} % full: end what takes it there (top -o %MEM)"
    DISK = "its disk is {disk} % full at {disk_path}: make room there (du -xh {disk_word})"
    HOT = "its machine is at {temperature} °C and may slow down: cool it, or let it do less"

    @classmethod
    def of(cls, cause: MachineCause, state: MachineState | ShownMachine) -> str:
        # The path is the peer's word, and the command is for a shell.
        return cls[cause.name](**msgspec.structs.asdict(state), disk_word=quote(state.disk_path))


class _Limit(NamedTuple):
    """A figure from which on something is wrong, below which it is over, and for how many reports it has to last."""

    begins: int
    ends: int
    reports: int


_LIMITS: Final[Mapping[MachineCause, _Limit]] = {
    MachineCause.CPU: _Limit(97, 90, 3),
    MachineCause.MEMORY: _Limit(95, 90, 1),
    MachineCause.DISK: _Limit(98, 95, 1),
    MachineCause.HOT: _Limit(85, 80, 1),
}
"""Round figures; at 85 °C, small computers begin to throttle their processors. A build that takes 10 s is no fault."""


class MachineJudge:
    """Tells what is wrong with a machine, by its reports in their order.

    Attributes:
        wrong: at present, in the order of `MachineCause`.
    """

    def __init__(self) -> None:
        self.wrong: tuple[MachineCause, ...] = ()
        self._reports: Counter[MachineCause] = Counter()

    def take(self, state: MachineState) -> None:
        self.wrong = tuple(cause for cause, limit in _LIMITS.items() if self._is_wrong(cause, limit, state))

    def _is_wrong(self, cause: MachineCause, limit: _Limit, state: MachineState) -> bool:
        figure = _figure(cause, state)
        if figure is None:
            return cause in self.wrong
        self._reports[cause] = self._reports[cause] + 1 if figure >= limit.begins else 0
        return figure >= limit.ends if cause in self.wrong else self._reports[cause] >= limit.reports


def _figure(cause: MachineCause, state: MachineState) -> int | None:
    figure: int | None = getattr(state, "temperature" if cause is MachineCause.HOT else cause.value)
    return figure
