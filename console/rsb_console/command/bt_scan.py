"""``rsb-console bt-scan``: adapters, channels and devices, for people or as JSON."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS
from rsb_bridge.bluetooth.scan import ChannelUse, Scan, scan
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import FAILURE, OK, print_error, print_line

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Iterator


def scan_bluetooth(arguments: Namespace) -> int:
    return run_bt_scan(arguments.adapter, arguments.json)


def run_bt_scan(adapter: str | None, as_json: bool) -> int:
    """Scan once, with an adapter by its name or address, or all of them, and print the result.

    Returns:
        0, or 1 if Bluetooth cannot be used in its present state.
    """
    found = asyncio.run(scan(adapter))
    if as_json:
        print_line(json_line({"ok": found.usable, **asdict(found)}))
    else:
        for line in _lines(found):
            print_line(line)
        for problem in found.problems:
            print_error(problem)
    return OK if found.usable else FAILURE


def _lines(found: Scan) -> Iterator[str]:
    for adapter in found.adapters:
        yield "  ".join(
            filter(None, (adapter.name, adapter.address, "on" if adapter.powered else "off", adapter.alias))
        )
        yield from _channels(found, adapter.address)
    if found.channels:
        yield f"any   {ANY_ADAPTER}"
        yield from _channels(found, ANY_ADAPTER)
        free = [number for number in CHANNELS if all(use[number] is ChannelUse.FREE for use in found.channels.values())]
        yield f"channels to choose from: {_ranges(free)}"
    for device in found.devices:
        states = ", ".join(word for word in ("paired", "connected") if getattr(device, word))
        yield f"{device.address}  {device.name}  {states} ({device.adapter})"


def _channels(found: Scan, address: str) -> Iterator[str]:
    use = found.channels.get(address, {})
    busy = [number for number in use if use[number] is ChannelUse.BUSY]
    if use:
        yield f"      busy: {_ranges(busy)}"


def _ranges(numbers: Iterable[int]) -> str:
    """Format numbers as ``1-4, 7``, or ``none``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs) or "none"
