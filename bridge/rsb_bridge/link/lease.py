"""Keeping a link's lease: numbers to and from the other side, for as long as anything is armed (PROTOCOL.md, 7.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.route.lease import BEAT, Lease, Standstill
from rsb_bridge.wire import messages as wire
from rsb_bridge.wire.headers import LEASE_FEATURE

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.route.peer import Peer


class LinkLease:
    """Sends this side's numbers, and hears the other's.

    Args:
        context: has the clock and the loop.
        peer: the other side.
        is_needed: whether any route is armed or asked for.
        lives: called when the two sides hear each other, for the first time or again.
        disarm: disarms all routes when something stood still.

    Attributes:
        state: what it proves now.
    """

    def __init__(
        self,
        context: Context,
        peer: Peer,
        is_needed: Callable[[], bool],
        lives: Callable[[], None],
        disarm: Callable[[Standstill], None],
    ) -> None:
        self.state = Lease(context.clock.steady, context.ros.turns, self._over)
        self._loop = context.loop
        self._peer = peer
        self._is_needed = is_needed
        self._lives = lives
        self._disarm = disarm
        self._timer: asyncio.TimerHandle | None = None

    @property
    def supported(self) -> bool:
        """Whether the other side takes part."""
        return LEASE_FEATURE in self._peer.features

    def hold(self) -> None:
        """Keep the lease from now on, for a route that is about to be armed, and send a number at once."""
        if self.state.over is not None:
            self._end()
        if not self.state.is_on:
            self.state.begin()
        self._send()
        if self._timer is None:
            self._timer = self._loop.call_later(BEAT, self._beat)

    def handle(self, message: wire.Lease) -> None:
        """Take a number of the other side's. A side that has not heard any yet is answered at once."""
        state = self.state
        was_alive, had_begun = state.alive, state.begun
        state.hear(message.number, message.echo)
        lives = state.alive and not was_alive
        if state.is_on and (lives or not message.echo):
            self._send()
        if state.alive and state.begun and not (was_alive and had_begun):
            self._lives()

    def stop(self) -> None:
        """The connection is over."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.state.end()

    def _beat(self) -> None:
        self._timer = None
        if not self._is_needed():
            self.state.end()
            return
        self._send()
        if self.state.over is None:
            self._timer = self._loop.call_later(BEAT, self._beat)

    def _send(self) -> None:
        self._peer.send(wire.Lease(*self.state.beat()))

    def _over(self) -> None:
        """Disarm all routes at the next turn of the loop: the caller may be in the midst of publishing."""
        self._loop.call_soon(self._end)

    def _end(self) -> None:
        over = self.state.over
        if over is not None and self.state.is_on:
            self._disarm(over)
            self.stop()
