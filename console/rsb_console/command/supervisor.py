"""What systemd is told of a bridge: that it is ready, how it is, and that it still works (sd_notify(3))."""

from __future__ import annotations

import contextlib
import socket
from typing import TYPE_CHECKING

from rsb_console.command.reports import summary

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.model.snapshot import Snapshot


class Supervisor:
    """Tells systemd; without systemd, nobody.

    Args:
        environ: has the address that systemd listens on.
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address  # an abstract socket of Linux
        self._alive_at = 0.0
        self._status = ""

    def ready(self) -> None:
        """The bridge has started, or has reloaded."""
        self._tell("READY=1")

    def reloading(self, monotonic_ns: int) -> None:
        """The session file is about to be read again; `ready` says when that is done.

        Args:
            monotonic_ns: now, on the clock CLOCK_MONOTONIC.
        """
        self._tell(f"RELOADING=1\nMONOTONIC_USEC={monotonic_ns // 1000}")

    def show(self, now: Snapshot) -> None:
        """Tell how the bridge is. It works as long as its snapshots are renewed, which its I/O thread does."""
        if now.time == self._alive_at:
            return
        self._alive_at = now.time
        status = summary(now)
        self._tell("WATCHDOG=1" if status == self._status else f"WATCHDOG=1\nSTATUS={status}")
        self._status = status

    def stopping(self) -> None:
        """The bridge is about to end."""
        self._tell("STOPPING=1")

    def _tell(self, state: str) -> None:
        if self._address:
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
                notify.setblocking(False)
                notify.sendto(state.encode(), self._address)
