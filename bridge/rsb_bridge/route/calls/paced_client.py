"""A client of a service here, whose requests wait their turn so that the node loses none of them."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Hashable

    from rsb_bridge.ros.ros_interface import ServiceClient

_UNREAD = 8
"""Requests that a node may have without having read them. It keeps 10 by default, and loses the oldest of 50 that a
link delivers at once after a gap. One of the other two is the probe."""
_SILENT, _LEAST_SILENT = 0.5, 0.02
"""s without an answer after which the next requests are sent all the same, at first and after many such times. Round
figures: a node may answer in any order, late, or only once it has more requests."""


class PacedClient:
    """Sends the next request once the node has read earlier ones.

    A node reads its requests in order, so an answer shows that it has read all of them up to that one.

    Args:
        probe: a request that the node answers as soon as it reads it, for a service that answers other ones much later;
            or empty.

    Attributes:
        waiting: sends each request that waits, by a key of its owner.
    """

    def __init__(self, client: ServiceClient, loop: asyncio.AbstractEventLoop, probe: bytes = b"") -> None:
        self.waiting: dict[Hashable, Callable[[], object]] = {}
        self._client = client
        self._loop = loop
        self._probe = probe
        self._sent = self._read = self._probed = 0  # the newest numbers
        self._since = 0.0  # s, when the node last answered, or got the first request that it may not have read
        self._silent = _SILENT
        self._timer: asyncio.TimerHandle | None = None

    @property
    def ready(self) -> bool:
        return self._client.ready

    @property
    def is_busy(self) -> bool:
        """Whether the next request has to wait."""
        return bool(self.waiting) or self._sent - self._read >= _UNREAD

    def call(self, request: bytes) -> int:
        """Send a request at once, and return its number.

        Raises:
            RosError: the middleware refuses it.
        """
        number = self._client.call(request)
        if self._sent == self._read:
            self._since = self._loop.time()
        self._sent = number
        return number

    def in_turn(self, key: Hashable, send: Callable[[], object]) -> None:
        """Have `send` make a call: now, or in its turn unless its key is removed from `waiting` before."""
        if not self.is_busy:
            send()
            return
        self.waiting[key] = send
        self._watch()

    def answered(self, number: int) -> bool:
        """Note an answer, and send what waited for it. Return whether it is the probe's, which nobody waits for."""
        is_probe = number == self._probed
        self._read, self._since, self._silent = max(self._read, number), self._loop.time(), _SILENT
        self._send_waiting()
        return is_probe

    def close(self) -> None:
        """Close the client; what waits is not sent."""
        self.waiting.clear()
        if self._timer is not None:
            self._timer.cancel()
        self._client.close()

    def _send_waiting(self) -> None:
        while self.waiting and self._sent - self._read < _UNREAD:
            self.waiting.pop(next(iter(self.waiting)))()
        if self.waiting:
            self._watch()

    def _watch(self) -> None:
        """See to it that what waits is sent, even if the node answers nothing."""
        if self._probe and self._probed <= self._read:
            with contextlib.suppress(RosError):
                self._probed = self.call(self._probe)
        if self._timer is None:
            self._timer = self._loop.call_at(self._since + self._silent, self._look)

    def _look(self) -> None:
        self._timer = None
        if self.waiting and self._loop.time() >= self._since + self._silent:
            self._read, self._since = self._sent, self._loop.time()
            self._silent = max(_LEAST_SILENT, self._silent / 2)
        self._send_waiting()
