"""News of this machine's network devices, addresses and routes, as its kernel tells them (rtnetlink(7))."""

from __future__ import annotations

import asyncio
import ctypes
import os
import socket
from ipaddress import ip_address
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

_NETLINK_ROUTE = 0
# RTMGRP_LINK, RTMGRP_IPV4_IFADDR, RTMGRP_IPV4_ROUTE, RTMGRP_IPV6_IFADDR and RTMGRP_IPV6_ROUTE
_GROUPS = 0x1 | 0x10 | 0x40 | 0x100 | 0x400
_SETTLES = 0.05
"""s between a first change and the call, and between two calls. To join a network takes some 20 changes in 30 ms."""
_KEPT = 4096  # bytes of changes that the kernel keeps for us: nobody reads them
_AT_MOST = 200  # changes that are thrown away in one turn of the loop; some thirty fill `_KEPT`
_IFF_UP, _IFF_LOOPBACK, _IFF_RUNNING = 0x1, 0x8, 0x40  # the last: the device carries (netdevice(7))


class SilenceText(Wording):
    """The reasons why nothing leaves this machine from one of its addresses."""

    GONE = "{address} is no address of this machine any more"
    DOWN = "{device} is down"
    NO_CARRIER = "{device} has no carrier"


class NameText(Wording):
    """The reasons why a host's name cannot be looked up now, each with its remedy."""

    NO_NETWORK = "this machine has no network but lo: plug in a cable, or join a Wi-Fi"
    NO_NAME_SERVER = "no name server answers: check this machine's network, or write server_ip as a number"


def open_news() -> socket.socket:
    """Return a socket that is readable once the kernel has changed a device, an address or a route.

    Raises:
        OSError: the kernel, or a container's rules, tell nobody.
    """
    news = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_NONBLOCK, _NETLINK_ROUTE)
    try:
        news.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KEPT)
        news.bind((0, _GROUPS))
    except OSError:
        news.close()
        raise
    return news


class NetworkNews:
    """Tells of changes, on the running loop, until it is closed. While nothing changes, it does nothing."""

    def __init__(self, changed: Callable[[], None]) -> None:
        """Begin to listen; raises as `open_news`.

        Args:
            changed: called once for all changes within `_SETTLES` s.
        """
        self._changed = changed
        self._socket = open_news()
        self._timer: asyncio.TimerHandle | None = None
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._socket, self._begin)

    def close(self) -> None:
        self._loop.remove_reader(self._socket)
        if self._timer is not None:
            self._timer.cancel()
        self._socket.close()

    def _begin(self) -> None:
        self._loop.remove_reader(self._socket)  # so that a storm of changes wakes nobody
        self._timer = self._loop.call_later(_SETTLES, self._tell)

    def _tell(self) -> None:
        for _ in range(_AT_MOST):
            try:
                self._socket.recv(_KEPT)
            except BlockingIOError:
                break
            except OSError:  # the kernel has thrown some away: they are news as well
                continue
        self._loop.add_reader(self._socket, self._begin)
        self._changed()

    def why_silent(self, address: str) -> str:
        """Return why nothing leaves this machine from one of its addresses, for operators, or an empty string."""
        try:
            ip_address(address)
            device = _device_of(address)
        except (ValueError, OSError):  # a stream over another network has an address of that
            return ""
        if device is None:
            return SilenceText.GONE(address=address)
        if not device.flags & _IFF_UP:
            return SilenceText.DOWN(device=device.name)
        return "" if device.flags & _IFF_RUNNING else SilenceText.NO_CARRIER(device=device.name)


def news_of_kernel(changed: Callable[[], None]) -> NetworkNews | None:
    """Return news, as `rsb_bridge.transport.transport.StreamTransport.network_news` does."""
    try:
        return NetworkNews(changed)
    except OSError:  # doctor tells of it
        return None


def has_network() -> bool:
    """Whether this machine has an address of another device than lo, as far as its kernel tells."""
    try:
        return any(each.flags & (_IFF_UP | _IFF_LOOPBACK) == _IFF_UP for each in _devices())
    except OSError:
        return True


def device_of(address: str) -> str:
    """Return the name of the network device that has an address, or an empty string. It takes up to 1 ms."""
    try:
        device = _device_of(address)
    except OSError:
        return ""
    return "" if device is None else device.name


def addresses() -> Sequence[tuple[str, str]]:
    """Return this machine's network devices, each with each of its addresses; raises as `_devices`."""
    return [(each.name, each.address) for each in _devices()]


class _Device(NamedTuple):
    name: str
    flags: int
    address: str


def _device_of(address: str) -> _Device | None:
    """Find a device; raises as `_devices`."""
    wanted = address.partition("%")[0]
    return next((each for each in _devices() if each.address == wanted), None)


class _InterfaceAddress(ctypes.Structure):
    """A struct ifaddrs (getifaddrs(3))."""


_InterfaceAddress._fields_ = [
    ("next", ctypes.POINTER(_InterfaceAddress)),
    ("name", ctypes.c_char_p),
    ("flags", ctypes.c_uint),
    ("address", ctypes.c_void_p),
    ("rest", ctypes.c_void_p * 3),
]
_PLACES = {socket.AF_INET: (4, 4), socket.AF_INET6: (8, 16)}
"""By family, where a struct sockaddr has its address, and how many bytes that has."""


def _devices() -> Iterator[_Device]:
    """Yield this machine's network devices, each once for each of its addresses.

    Raises:
        OSError: the kernel does not tell.
    """
    library = ctypes.CDLL(None, use_errno=True)
    first = ctypes.POINTER(_InterfaceAddress)()
    if library.getifaddrs(ctypes.byref(first)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    try:
        at = first
        while at:
            each = at.contents
            family = ctypes.c_ushort.from_address(each.address).value if each.address else None
            if family in _PLACES:
                offset, size = _PLACES[socket.AddressFamily(family)]
                raw = ctypes.string_at(each.address + offset, size)
                yield _Device(os.fsdecode(each.name), each.flags, socket.inet_ntop(family, raw))
            at = each.next
    finally:
        library.freeifaddrs(first)
