"""The kernel's Bluetooth adapters and RFCOMM sockets, and the reasons why they can't be opened."""

from __future__ import annotations

import array
import errno
import fcntl
import socket
import struct
from dataclasses import dataclass

from rsb_bridge.model.wording import Wording

ANY_ADAPTER = "00:00:00:00:00:00"
"""Binds a channel on all adapters (``BDADDR_ANY``)."""

CHANNELS = range(1, 31)
"""RFCOMM server channels (Bluetooth Core, RFCOMM 5.4). The kernel binds other numbers too, but they don't work."""

# linux/include/net/bluetooth/{bluetooth,hci,hci_sock}.h. Numbers: a Python without AF_BLUETOOTH can list adapters too.
_AF_BLUETOOTH = 31
_BTPROTO_HCI = 1
_HCIGETDEVINFO = 0x800448D3
_HCI_MAX_DEV = 16
_HCI_UP = 1
_DEVICE_INFO = struct.Struct("H8s6sI72x")  # number, name, address, flags, unused


class NoBluetooth(Wording):
    """The reasons why Bluetooth sockets can't be opened, each with its remedy."""

    NOT_IN_KERNEL = (
        "no Bluetooth in this kernel, or hidden by a container: modprobe bluetooth; in a container, use the host's "
        "network (--network host)"
    )
    NO_RFCOMM = "this kernel's Bluetooth lacks RFCOMM: modprobe rfcomm"
    FORBIDDEN = (
        "Bluetooth sockets are forbidden here, by a container's seccomp profile or by the unit's "
        "RestrictAddressFamilies: add AF_BLUETOOTH"
    )
    FORBIDDEN_BY_SECURITY_MODULE = (
        "Bluetooth sockets are forbidden here by a security module: see the kernel's log (dmesg) for which"
    )
    NOT_IN_PYTHON = (
        "this Python was built without Bluetooth sockets (socket.AF_BLUETOOTH): use the distribution's own "
        "(/usr/bin/python3), or build with libbluetooth-dev installed"
    )
    REFUSED = "no Bluetooth: {reason}"


_REASONS = {
    errno.EAFNOSUPPORT: NoBluetooth.NOT_IN_KERNEL,
    errno.EPROTONOSUPPORT: NoBluetooth.NO_RFCOMM,
    errno.EPERM: NoBluetooth.FORBIDDEN,
    errno.EACCES: NoBluetooth.FORBIDDEN_BY_SECURITY_MODULE,
}


class NoBluetoothError(OSError):
    """Bluetooth sockets can't be opened; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Adapter:
    """One Bluetooth adapter of this machine.

    Attributes:
        name: the kernel's, ``hci0``.
        address: its MAC, which a server's session has as `server_ip`.
        alias: its name on other machines, or empty if BlueZ was not asked.
    """

    name: str
    address: str
    powered: bool
    alias: str = ""


def adapters() -> list[Adapter]:
    """Return the kernel's adapters, by number.

    Raises:
        NoBluetoothError: the kernel has no Bluetooth, or access is denied.
    """
    found = []
    with _open(_AF_BLUETOOTH, socket.SOCK_RAW, _BTPROTO_HCI) as sock:
        for number in range(_HCI_MAX_DEV):
            info = array.array("B", struct.pack("H", number) + bytes(_DEVICE_INFO.size - 2))
            try:
                fcntl.ioctl(sock, _HCIGETDEVINFO, info)
            except OSError as error:
                if error.errno == errno.ENODEV:  # numbers may have gaps
                    continue
                raise NoBluetoothError(_message(error)) from None
            _, name, address, flags = _DEVICE_INFO.unpack(info)
            mac = ":".join(f"{byte:02X}" for byte in reversed(address))  # the kernel has the last byte first
            found.append(Adapter(name.rstrip(b"\0").decode(), mac, bool(flags & _HCI_UP)))
    return found


def rfcomm_socket() -> socket.socket:
    """Return a new RFCOMM stream socket.

    Raises:
        NoBluetoothError: this Python or this machine has no Bluetooth.
    """
    if not hasattr(socket, "AF_BLUETOOTH"):
        raise NoBluetoothError(NoBluetooth.NOT_IN_PYTHON())
    return _open(socket.AF_BLUETOOTH, socket.SOCK_STREAM, socket.BTPROTO_RFCOMM)


def _open(family: int, kind: int, protocol: int) -> socket.socket:
    try:
        return socket.socket(family, kind, protocol)
    except OSError as error:
        raise NoBluetoothError(_message(error)) from None


def _message(error: OSError) -> str:
    return _REASONS.get(error.errno or 0, NoBluetooth.REFUSED)(reason=error.strerror)
