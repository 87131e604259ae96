"""File descriptors, of which each link and each port of a topic takes some, and ports, as the kernel grants them."""

from __future__ import annotations

import errno
import os
import resource
import socket
import sys
from pathlib import Path

from rsb_bridge.model.wording import Wording

RESERVE = 64
"""Descriptors that data streams leave to control connections, DDS, key files and other uses that must not fail. A round
figure: a side with 500 topics has 31 of TCP in all (bench/README.md, *Thin links*)."""

SHORTAGES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
"""Errors of a call that would succeed if the process or the system had more to give."""

_OWN = "/proc/self/fd"
_UNPRIVILEGED = Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")
_UNPRIVILEGED_BY_DEFAULT = 1024

MORE_DESCRIPTORS = "raise the limit (ulimit -n, or LimitNOFILE in a systemd unit)"
"""What an operator does when they run out."""


class Scarcity(Wording):
    """Shortages of file descriptors."""

    ROUTE_WITHOUT_STREAM = "the {side} may have {limit:,} file descriptors and needs more: {remedy} there"


def first_open_port() -> int:
    """Return the lowest port that this machine lets users without rights bind (ip(7), ip_unprivileged_port_start)."""
    try:
        return int(_UNPRIVILEGED.read_text())
    except (OSError, ValueError):
        return _UNPRIVILEGED_BY_DEFAULT


def scarce() -> bool:
    """Whether only the reserve is left, so that no further stream should be opened for a route."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return False
    try:
        with socket.socket() as probe:  # the kernel gives the lowest number that is free
            return probe.fileno() >= limit - RESERVE
    except OSError:
        return True


def left() -> int:
    """Return the number of descriptors that routes may still open, without the reserve."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return sys.maxsize
    try:
        return max(0, limit - RESERVE - _held())
    except OSError:
        return 0


def _held() -> int:
    """Return how many this process has. Does not list them: each stream asks, at a cost of their number squared."""
    # Linux 6.2 and newer; an older one says 0.
    return os.stat(_OWN).st_size or len(os.listdir(_OWN))  # noqa: PTH116, PTH208 -- half the time


def for_arrivals(limit: int) -> int:
    """Return how many of so many descriptors tell of arrivals from ROS, one an endpoint; beyond, endpoints share.

    Half of what the reserve leaves: without its own, a message costs more, while a stream does not come about.
    """
    return max(0, limit - RESERVE) // 2


def scarcity_message(side: str) -> str:
    """Return the reason why a route has no stream and the remedy, for the operators of both sides.

    Args:
        side: the side whose process lacks descriptors, ``client`` or ``server``.
    """
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return Scarcity.ROUTE_WITHOUT_STREAM(side=side, limit=limit, remedy=MORE_DESCRIPTORS)
