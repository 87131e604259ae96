"""The lines on a machine, on the page of its link and in ``status``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import plural
from rsb_console.feature_console import LinkFact
from rsb_console.notation import formats
from rsb_extras.machine_state.machine_figures import MACHINE, MEGABYTE, MachineFault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import LinkSnapshot


def figures(link: LinkSnapshot) -> Sequence[str]:
    """Return the machine's figures, or nothing without its reports."""
    machine = MACHINE.of(link)
    if machine is None:
        return ()
    load = f"load {machine.load:.1f} on {machine.cores} {plural(machine.cores, 'processor')}"
    first = [load] if machine.cpu is None else [f"processors {machine.cpu} %", load]
    if machine.temperature is not None:
        first.append(f"{machine.temperature} °C")
    second = [f"memory {machine.memory} % of {formats.byte_count(machine.memory_mb * MEGABYTE)}"]
    if machine.disk_path:
        left = formats.byte_count(machine.disk_mb * MEGABYTE)
        second.append(f"disk {machine.disk_path} {machine.disk} %, {left} left")
    return ", ".join(first), ", ".join(second)


def faults(link: LinkSnapshot) -> Sequence[str]:
    """Return a sentence with the remedy for each thing that the machine is short of."""
    machine = MACHINE.of(link)
    return () if machine is None else [MachineFault.of(cause, machine) for cause in machine.wrong]


FACT = LinkFact("its machine", figures, faults)
