"""Which Bluetooth adapters this machine has, which of their RFCOMM channels are free, and which devices are near."""

from __future__ import annotations

import errno
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.bluez import BluezError, Device, read_bluez
from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS, Adapter, NoBluetoothError

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Snapshot

__all__ = ["ANY_ADAPTER", "CHANNELS", "Adapter", "Device", "Scan", "Use", "held_channels", "scan"]


class Use(StrEnum):
    """What a channel is doing."""

    FREE = "free"
    BUSY = "busy"
    OWN = "own"


@dataclass(frozen=True, slots=True)
class Scan:
    """What was found.

    Attributes:
        adapters: by name.
        channels: what each of `CHANNELS` is doing, by address and number: of each adapter, and of `ANY_ADAPTER`. To the
            kernel they don't conflict, but connections go to the adapter's listener: choose one that is free on both.
            Empty where channels can't be tried.
        devices: paired or connected.
        problems: what stood in the way, each with its remedy.
    """

    adapters: tuple[Adapter, ...] = ()
    channels: dict[str, dict[int, Use]] = field(default_factory=dict)
    devices: tuple[Device, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether a session could be bound or connected: an adapter is on and channels can be had."""
        return bool(self.channels) and any(adapter.powered for adapter in self.adapters)


async def scan(adapter: str | None = None, own_channels: Collection[tuple[str, int]] = ()) -> Scan:
    """Look at the adapters, their channels and their devices; takes some ms, and up to 5 s where BlueZ hangs.

    A channel is tried by binding it for a moment. What nobody listens on any more looks free, even while a connection
    accepted there lives on.

    Args:
        adapter: only this one, by its name (``hci0``) or address; None: all.
        own_channels: address (an adapter's, or `ANY_ADAPTER`) and number of those that this process itself holds.
    """
    problems: list[str] = []
    try:
        found = {one.name: one for one in hci.adapters()}
    except NoBluetoothError as error:
        return Scan(problems=(str(error),))
    if not found:
        return Scan(problems=("no Bluetooth adapter: plug one in; in a virtual machine, pass it through (see lsusb)",))
    devices: list[Device] = []
    try:
        known, devices = await read_bluez()
        found |= {one.name: one for one in known}
    except BluezError as error:
        problems.append(f"{error}. Names and paired devices stay unknown")
    chosen = [one for one in found.values() if adapter is None or adapter.casefold() in _names(one)]
    if not chosen:
        here = ", ".join(f"{one.name} ({one.address})" for one in found.values())
        return Scan(problems=(*problems, f"no adapter {adapter}: there is {here}"))
    problems += [_why_off(one) for one in chosen if not one.powered]
    channels = {}
    try:
        for address in (*(one.address for one in chosen), ANY_ADAPTER):
            own = {number for held_on, number in own_channels if held_on.upper() == address}
            channels[address] = {number: Use.OWN if number in own else _try(address, number) for number in CHANNELS}
    except NoBluetoothError as error:
        problems.append(f"{error}. Channels can't be tried")
    names = {one.name for one in chosen}
    return Scan(tuple(chosen), channels, tuple(one for one in devices if one.adapter in names), tuple(problems))


def held_channels(session: Session, snapshot: Snapshot) -> set[tuple[str, int]]:
    """The channels that an engine listens on: `scan`'s `own_channels`."""
    if session.adapter is None or session.role != "server" or not snapshot.running:
        return set()
    channels = {route.port for route in snapshot.routes if route.transport == "bluetooth"}
    if session.is_bluetooth:
        channels.add(session.server_port)
    return {(session.adapter, channel) for channel in channels}


def _names(adapter: Adapter) -> tuple[str, str]:
    return adapter.name.casefold(), adapter.address.casefold()


def _why_off(adapter: Adapter) -> str:
    """A switched-off adapter and how to switch it on (Documentation/driver-api/rfkill.rst)."""
    if _blocked(adapter.name, "hard"):
        return f"{adapter.name} is off: by the machine's radio switch or in its firmware's setup"
    if _blocked(adapter.name, "soft"):
        return f"{adapter.name} is off: rfkill unblock bluetooth"
    return f"{adapter.name} is off: bluetoothctl power on (without BlueZ: hciconfig {adapter.name} up)"


def _blocked(name: str, kind: str) -> bool:
    return any(file.read_text().strip() == "1" for file in Path("/sys/class/bluetooth", name).glob(f"rfkill*/{kind}"))


def _try(address: str, number: int) -> Use:
    with hci.rfcomm_socket() as sock:
        try:
            sock.bind((address, number))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return Use.BUSY
            raise NoBluetoothError(f"channel {number} on {address}: {error.strerror}") from None
    return Use.FREE
