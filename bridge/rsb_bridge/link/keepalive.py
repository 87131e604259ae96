"""Whether a peer lives, how far away it is, what its clock says, and how much crosses the link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.wire.messages import Ping, Pong

if TYPE_CHECKING:
    from rsb_bridge.context import Context

DEAD_AFTER = 5.0
"""s without a byte from the peer until the link is given up."""


class Keepalive:
    """One connection's pings and byte counts.

    Attributes:
        clock: round trip and clock offset.
        rx_rate: wire bytes/s received.
        tx_rate: wire bytes/s sent.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self.clock = ClockOffset()
        self.rx_rate = 0.0
        self.tx_rate = 0.0
        self._heard = context.now()
        self._received = 0
        self._rx = 0
        self._tx = 0
        self._pings = 0

    def look(self, received: int, now: float) -> None:
        """As often as wanted: note whether anything has come, by the bytes received so far."""
        if received > self._received:
            self._heard = now
        self._received = received

    def tick(self, received: int, sent: int, now: float) -> Ping:
        """Once a second: note the byte counts so far; the ping to send."""
        self.look(received, now)
        self.rx_rate += 0.5 * (max(0, received - self._rx) - self.rx_rate)
        self.tx_rate += 0.5 * (max(0, sent - self._tx) - self.tx_rate)
        self._rx, self._tx = received, sent
        self._pings += 1
        return Ping(n=self._pings, sent=self._context.wall_ns())

    def quiet(self, now: float) -> float:
        """How long (s) nothing has come."""
        return now - self._heard

    def answer(self, ping: Ping) -> Pong:
        """The answer to the peer's ping."""
        now = self._context.wall_ns()
        return Pong(n=ping.n, sent=ping.sent, received=now, answered=now)

    def answered(self, pong: Pong) -> None:
        """The peer answered ours."""
        self.clock.add(pong.sent, pong.received, pong.answered, self._context.wall_ns())
