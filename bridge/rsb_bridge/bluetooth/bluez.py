"""BlueZ: its adapters and the devices that it knows, over D-Bus."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import msgspec
from dbus_fast import BusType, DBusFastError, Message, MessageType, unpack_variants
from dbus_fast.aio import MessageBus

from rsb_bridge.bluetooth.hci import Adapter
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording

_TIMEOUT = 5.0
"""s. A round figure: BlueZ answers within some ms, or hangs."""
_NOT_THERE = {
    "org.freedesktop.DBus.Error.ServiceUnknown",
    "org.freedesktop.DBus.Error.NameHasNoOwner",
    "org.freedesktop.DBus.Error.NoReply",
    "org.freedesktop.DBus.Error.TimedOut",
    "org.freedesktop.systemd1.NoSuchUnit",
}


class BluezProblem(Wording):
    """The reasons why BlueZ cannot be asked, each with its remedy."""

    BLUEZ_SILENT = "BlueZ does not answer: systemctl restart bluetooth"
    BLUEZ_STOPPED = "BlueZ is not running: systemctl start bluetooth (Debian, Ubuntu: apt install bluez)"
    BLUEZ_FORBIDDEN = "this user has no access to BlueZ: usermod -aG bluetooth USER, then log in again ({reason})"
    NO_DBUS = (
        "can't connect to the D-Bus system bus, which BlueZ needs ({error}): is dbus installed and running? "
        "In a container, mount /run/dbus"
    )


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
        raise BluezError(BluezProblem.BLUEZ_SILENT()) from None
    except (OSError, DBusFastError, EOFError) as error:
        raise BluezError(BluezProblem.NO_DBUS(error=error)) from None
    finally:
        bus.disconnect()
    assert reply is not None, "a method call without NO_REPLY_EXPECTED has a reply"
    if reply.message_type is MessageType.ERROR:
        raise BluezError(_refusal(reply))
    return unpack_variants(reply.body[0])


def _refusal(reply: Message) -> str:
    if reply.error_name in _NOT_THERE:
        return BluezProblem.BLUEZ_STOPPED()
    reason = reply.body[0] if reply.body else reply.error_name
    if reply.error_name == "org.freedesktop.DBus.Error.AccessDenied":
        return BluezProblem.BLUEZ_FORBIDDEN(reason=reason)
    return f"BlueZ refused: {reason}"
