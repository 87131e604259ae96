"""A scan of this machine's Bluetooth adapters, their RFCOMM channels, and the devices they know."""

from __future__ import annotations

import errno
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.bluez import BluezError, Device, read_bluez
from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS, Adapter, NoBluetoothError
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Snapshot


class ScanProblem(Wording):
    """The reasons why a scan is incomplete, each with its remedy."""

    NO_ADAPTER = "no Bluetooth adapter: plug one in; in a virtual machine, pass it through (see lsusb)"
    ADAPTER_UNKNOWN = "no adapter {adapter}; this machine has {known}"
    SOFT_BLOCKED = "{adapter} is off: rfkill unblock bluetooth"
    SWITCHED_OFF = "{adapter} is off: bluetoothctl power on (without BlueZ: hciconfig {adapter} up)"


class ChannelUse(StrEnum):
    """A channel's user."""

    FREE = "free"
    BUSY = "busy"
    OWN = "own"


@dataclass(frozen=True, slots=True)
class Scan:
    """A scan's result.

    Attributes:
        adapters: sorted by name.
        channels: the user of each of `CHANNELS`, by address (an adapter's, or `ANY_ADAPTER`) and number. The kernel
            sees no conflict between the two addresses, but connections go to the adapter's listener: choose a channel
            that is free on both. Empty if channels can't be tried.
        devices: paired or connected devices.
        problems: reasons why the scan is incomplete, each with a remedy.
    """

    adapters: tuple[Adapter, ...] = ()
    channels: dict[str, dict[int, ChannelUse]] = field(default_factory=dict)
    devices: tuple[Device, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether a session could be bound or connected: an adapter is on, and channels can be bound."""
        return bool(self.channels) and any(adapter.powered for adapter in self.adapters)


async def scan(adapter: str | None = None, own_channels: Collection[tuple[str, int]] = ()) -> Scan:
    """Scan adapters, channels and devices; takes a few ms, or up to 5 s if BlueZ hangs.

    A channel is tried by binding it for a moment. A channel without a listener looks free, even while a connection
    that was accepted there still exists.

    Args:
        adapter: the name (``hci0``) or address of the only adapter to scan, or None for all.
        own_channels: address (an adapter's, or `ANY_ADAPTER`) and number of the channels that this process uses itself.
    """
    problems: list[str] = []
    try:
        found = {one.name: one for one in hci.adapters()}
    except NoBluetoothError as error:
        return Scan(problems=(str(error),))
    if not found:
        return Scan(problems=(ScanProblem.NO_ADAPTER(),))
    devices: list[Device] = []
    try:
        known, devices = await read_bluez()
        found |= {one.name: one for one in known}  # BlueZ knows their aliases, too
    except BluezError as error:
        problems.append(f"{error}. Names and paired devices are unknown")
    chosen = [one for one in found.values() if adapter is None or adapter.casefold() in _names(one)]
    if not chosen:
        here = ", ".join(f"{one.name} ({one.address})" for one in found.values())
        return Scan(problems=(*problems, ScanProblem.ADAPTER_UNKNOWN(adapter=adapter, known=here)))
    problems += [_why_off(one) for one in chosen if not one.powered]
    channels = {}
    try:
        # Both: the kernel lets two listeners have one channel, one on an adapter and one on all of them.
        for address in (*(one.address for one in chosen), ANY_ADAPTER):
            own = {number for held_on, number in own_channels if held_on.upper() == address}
            channels[address] = {
                number: ChannelUse.OWN if number in own else _try(address, number) for number in CHANNELS
            }
    except NoBluetoothError as error:
        problems.append(f"{error}. Channels can't be tried")
    names = {one.name for one in chosen}
    return Scan(tuple(chosen), channels, tuple(one for one in devices if one.adapter in names), tuple(problems))


def held_channels(session: Session, snapshot: Snapshot) -> set[tuple[str, int]]:
    """Return the channels that an engine listens on, for `scan`'s `own_channels`."""
    if session.adapter is None or session.role != "server" or not snapshot.running:
        return set()
    channels = {route.port for route in snapshot.routes if route.transport == "bluetooth"}
    if session.is_bluetooth:
        channels.add(session.server_port)
    return {(session.adapter, channel) for channel in channels}


def _names(adapter: Adapter) -> tuple[str, str]:
    return adapter.name.casefold(), adapter.address.casefold()


def _why_off(adapter: Adapter) -> str:
    """Return a remedy for an adapter that is off (Documentation/driver-api/rfkill.rst)."""
    if _blocked(adapter.name, "hard"):
        return f"{adapter.name} is off: by the machine's radio switch or in its firmware's setup"
    if _blocked(adapter.name, "soft"):
        return ScanProblem.SOFT_BLOCKED(adapter=adapter.name)
    return ScanProblem.SWITCHED_OFF(adapter=adapter.name)


def _blocked(name: str, kind: str) -> bool:
    return any(file.read_text().strip() == "1" for file in Path("/sys/class/bluetooth", name).glob(f"rfkill*/{kind}"))


def _try(address: str, number: int) -> ChannelUse:
    with hci.rfcomm_socket() as sock:
        try:
            sock.bind((address, number))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return ChannelUse.BUSY
            raise NoBluetoothError(f"channel {number} on {address}: {error.strerror}") from None
    return ChannelUse.FREE
