"""A scan of this machine's Bluetooth adapters, their RFCOMM channels, and the devices they know."""

from __future__ import annotations

import asyncio
import errno
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from dbus_fast import BusType, DBusFastError, Message, MessageType, unpack_variants
from dbus_fast.aio import MessageBus

from rsb_bridge.bluetooth import hci
from rsb_bridge.bluetooth.hci import ANY_ADAPTER, CHANNELS, Adapter, NoBluetoothError
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Snapshot

_TIMEOUT = 5.0
"""s. A round figure: BlueZ answers within some ms, or hangs."""
_NOT_THERE = {
    "org.freedesktop.DBus.Error.ServiceUnknown",
    "org.freedesktop.DBus.Error.NameHasNoOwner",
    "org.freedesktop.DBus.Error.NoReply",
    "org.freedesktop.DBus.Error.TimedOut",
    "org.freedesktop.systemd1.NoSuchUnit",
}


class ScanProblem(Wording):
    """The reasons why a scan is incomplete, each with its remedy."""

    BLUEZ_SILENT = "BlueZ does not answer: systemctl restart bluetooth"
    BLUEZ_STOPPED = "BlueZ is not running: systemctl start bluetooth (Debian, Ubuntu: apt install bluez)"
    BLUEZ_FORBIDDEN = "this user has no access to BlueZ: usermod -aG bluetooth USER, then log in again ({reason})"
    NO_DBUS = (
        "can't connect to the D-Bus system bus, which BlueZ needs ({error}): is dbus installed and running? "
        "In a container, mount /run/dbus"
    )
    NO_ADAPTER = "no Bluetooth adapter: plug one in; in a virtual machine, pass it through (see lsusb)"
    ADAPTER_UNKNOWN = "no adapter {adapter}; this machine has {known}"
    SOFT_BLOCKED = "{adapter} is off: rfkill unblock bluetooth"
    SWITCHED_OFF = "{adapter} is off: bluetoothctl power on (without BlueZ: hciconfig {adapter} up)"


class BluezError(Exception):
    """BlueZ can't be queried; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Device:
    """Another machine that BlueZ knows.

    Attributes:
        name: its own name, or its MAC.
        adapter: name of the adapter that knows it.
        paired: whether the two machines have exchanged keys.
        connected: whether they have a radio link now.
    """

    address: str
    name: str
    adapter: str
    paired: bool
    connected: bool


class _AdapterProperties(msgspec.Struct, rename="pascal"):
    address: str
    powered: bool
    alias: str


class _DeviceProperties(msgspec.Struct, rename="pascal"):
    address: str
    alias: str
    adapter: str
    paired: bool
    connected: bool


class _Interfaces(msgspec.Struct):
    adapter: _AdapterProperties | None = msgspec.field(name="org.bluez.Adapter1", default=None)
    device: _DeviceProperties | None = msgspec.field(name="org.bluez.Device1", default=None)


async def read_bluez() -> tuple[list[Adapter], list[Device]]:
    """Return all adapters, and the devices that are paired or connected, sorted by name.

    Raises:
        BluezError: D-Bus or BlueZ is missing, or access is denied.
    """
    return read_objects(await _managed_objects())


def read_objects(objects: object) -> tuple[list[Adapter], list[Device]]:
    """Return the adapters and devices among BlueZ's objects. Strangers choose their devices' names.

    Args:
        objects: the properties of each interface by path, interface and property name.

    Raises:
        BluezError: the objects are not as BlueZ documents them.
    """
    try:
        found = msgspec.convert(objects, dict[str, _Interfaces])
    except msgspec.ValidationError as error:
        raise BluezError(sanitize_text(f"BlueZ's answer is not as documented: {error}")) from None
    adapters = [
        Adapter(_last(path), sanitize_text(one.address), one.powered, sanitize_text(one.alias))
        for path, each in found.items()
        if (one := each.adapter) is not None
    ]
    devices = [
        Device(sanitize_text(it.address), sanitize_text(it.alias), _last(it.adapter), it.paired, it.connected)
        for each in found.values()
        if (it := each.device) is not None and (it.paired or it.connected)
    ]
    return sorted(adapters, key=lambda found: found.name), sorted(
        devices, key=lambda found: (found.adapter, found.name)
    )


def _last(path: str) -> str:
    return sanitize_text(path.rpartition("/")[2])


async def _managed_objects() -> object:
    """BlueZ's objects, for `read_objects`."""
    request = Message(
        destination="org.bluez",
        path="/",
        interface="org.freedesktop.DBus.ObjectManager",
        member="GetManagedObjects",
    )
    bus = MessageBus(bus_type=BusType.SYSTEM)
    try:
        async with asyncio.timeout(_TIMEOUT):
            await bus.connect()
            reply = await bus.call(request)
    except TimeoutError:
        raise BluezError(ScanProblem.BLUEZ_SILENT()) from None
    except (OSError, DBusFastError, EOFError) as error:
        raise BluezError(ScanProblem.NO_DBUS(error=error)) from None
    finally:
        bus.disconnect()
    assert reply is not None, "a method call without NO_REPLY_EXPECTED has a reply"
    if reply.message_type is MessageType.ERROR:
        raise BluezError(_refusal(reply))
    return unpack_variants(reply.body[0])


def _refusal(reply: Message) -> str:
    if reply.error_name in _NOT_THERE:
        return ScanProblem.BLUEZ_STOPPED()
    reason = reply.body[0] if reply.body else reply.error_name
    if reply.error_name == "org.freedesktop.DBus.Error.AccessDenied":
        return ScanProblem.BLUEZ_FORBIDDEN(reason=reason)
    return f"BlueZ refused: {reason}"


__all__ = ["ANY_ADAPTER", "CHANNELS", "Adapter", "ChannelUse", "Device", "Scan", "held_channels", "scan"]


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
