"""Pings a peer: measures silence, round trip and clock offset."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Protocol, TypeAlias

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.transport.streams import Stream
from rsb_bridge.wire.messages import Ping, Pong

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Collection

    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.transports import LinkProfile

ChannelCarrier: TypeAlias = "Stream | UdpChannel"  # carries bytes of a connection, and counts them

# Round figures.
DEAD_AFTER = 5.0  # s without a byte from the peer until the link is given up: five pings in a row went unanswered
_ALONE = 2  # times that for the control connection alone: on a thin link, its pings wait behind data
_DOUBTED = 0.2  # part of that until the connection is doubted: a second, in which a ping is due
# s, or round trips, that come on top: a lost packet comes again. So a slow path is doubted late, or never.
_MARGIN, _ROUND_TRIPS = 0.25, 2
_DOUBTED_IN_A_HURRY = 0.1  # s, or two round trips, for the answer to a ping after this machine's network has changed
_DOUBTED_EVERY = 0.25  # s. A round figure
_KERNELS = 1.0  # s by which the kernel is more patient: it would end a connection without the cause `silent`
_LONGEST_PING = 3600.0  # s; a ping that takes longer means that a clock was set
_UNANSWERED = 600  # pings that are remembered: ten minutes' worth. Later answers do not count for the clock
_ANSWERS, _ANSWERS_A_SECOND = 10, 4.0  # a peer pings once a second; after a pause of its process, several times at once


class PingedLink(Protocol):
    """The members of a link (`rsb_bridge.link.base_link.BaseLink`) whose connection is kept alive."""

    context: Context
    is_client: bool

    @property
    def profile(self) -> LinkProfile: ...

    def carriers(self) -> Collection[ChannelCarrier]: ...

    def doubts(self) -> None: ...

    def silent(self) -> None: ...


class Keepalive:
    """One connection's pings, or the figures of none yet.

    A connection is silent after `DEAD_AFTER` without a byte, or what its profile says instead. If only its control
    connection is silent, it is after twice as long.

    Attributes:
        answered_pings: number of the newest answered ping.
        ping_delay: delay (s) of the peer's last ping by its clock, or 0 if it is unknown.
        clock: round trip and clock offset.
        stamps: offset of the clock by which the peer stamps messages, and which nobody sets.
    """

    def __init__(self, link: PingedLink, control: ChannelCarrier | None = None) -> None:
        """Measure from now on; with a control connection, also look for silence, until `stop`."""
        context = link.context
        self.clock = ClockOffset()
        self.stamps = ClockOffset()
        self._sent_at: dict[int, int] = {}  # ns by the clock of stamps, by the ping's number
        self._context = context
        self._link = link
        self._patience = None if control is None else link.profile.patience
        self._began = context.now()
        self._pings = self.answered_pings = 0
        self._pinged_at = self._began
        self.ping_delay = 0.0
        self._answers = TokenBucket(_ANSWERS, _ANSWERS_A_SECOND, self._began)
        self._control = control
        self._watchdog: asyncio.TimerHandle | None = None
        self._hurried_at = -inf
        self._alone = False  # the control connection, when it was doubted
        if control is not None:
            self._watch_silence(control)

    @property
    def quiet(self) -> float:
        """Seconds since the last byte from the peer."""
        return self._context.now() - self._heard

    @property
    def control_quiet(self) -> float:
        """Seconds since the last byte on the control connection."""
        return 0.0 if self._control is None else self._context.now() - self._control.received_at

    @property
    def control_is_silent(self) -> bool:
        """Whether nothing comes on the control connection any more, though a ping is due each second."""
        return self.control_quiet > self._silent_after

    @property
    def _silent_after(self) -> float:
        return DEAD_AFTER if self._patience is None else self._patience

    @property
    def _heard(self) -> float:
        return max([each.received_at for each in self._link.carriers()], default=self._began)

    @property
    def round_trip(self) -> float | None:
        """Seconds of the last answered ping, or of the wait for the next answer if that is longer; None if unknown."""
        # By the clock of stamps: a wall clock that is set during a ping would make it as short as none.
        if self.stamps.rtt is None:
            return None
        return max(self.stamps.rtt, self.ping_wait)

    @property
    def ping_wait(self) -> float:
        """Seconds that the oldest unanswered ping has waited, about; 0 if all are answered."""
        unanswered = self._pings - self.answered_pings  # one a second
        return self._context.now() - self._pinged_at + unanswered - 1 if unanswered else 0.0

    def stop(self) -> None:
        if self._watchdog is not None:
            self._watchdog.cancel()

    @property
    def in_doubt(self) -> bool:
        """Whether nothing has come for so long that the connection may be dead, and a client may try a second one."""
        return self._context.now() >= self._doubtful_at

    @property
    def _doubted_after(self) -> float:
        return _DOUBTED * self._silent_after

    @property
    def _doubtful_at(self) -> float:
        heard, wait = self._heard, _ROUND_TRIPS * (self.stamps.rtt or 0.0)
        # What acknowledges and passes nothing on may hold the connections, while datagrams pass.
        alone = inf if self._control is None else self._control.received_at + (_ALONE - 1) * self._doubted_after
        doubtful_at = min(heard, alone) + self._doubted_after + max(_MARGIN, wait)
        if heard < self._hurried_at:
            return min(doubtful_at, self._hurried_at + max(_DOUBTED_IN_A_HURRY, wait))
        return doubtful_at

    def carried_since(self, time: float) -> bool:
        """Whether anything has come since then; if others carried when the control connection was doubted, on that."""
        heard = self._control.received_at if self._alone and self._control is not None else self._heard
        return heard >= time

    def hurry(self) -> None:
        """Doubt the connection soon, unless a ping that is sent now is answered."""
        self._hurried_at = self._context.now()
        if self._control is not None:
            self.stop()
            self._watch_silence(self._control)

    def _watch_silence(self, control: ChannelCarrier) -> None:
        patience = self._silent_after
        # The time of the silence, not the seconds until then: these could be too few for the clock to move.
        due = min(self._heard + patience, control.received_at + _ALONE * patience)
        now = self._context.now()
        if now >= due:
            self._link.silent()
            return
        if self._link.is_client:
            doubtful_at = self._doubtful_at
            if now >= doubtful_at:
                self._alone = self.quiet < self._doubted_after
                self._link.doubts()
            due = min(due, doubtful_at if now < doubtful_at else now + _DOUBTED_EVERY)
        self._watchdog = self._context.loop.call_at(due, self._watch_silence, control)

    def tick(self, handled: int) -> Ping:
        """Tell the kernel what is known of the peer, once a second, and return the ping to send, as `ping`."""
        for each in self._link.carriers():
            if isinstance(each, Stream):
                if self._patience is not None:  # each second, as streams come and go; a repetition costs nothing
                    each.give_up_after(self._patience + _KERNELS)
                if self.clock.rtt is not None:  # of an answered ping: an open one may wait for the network
                    each.round_trip_is(self.clock.rtt)
        return self.ping(handled)

    def ping(self, handled: int) -> Ping:
        """Return a further ping, to be sent now, with how many control messages of the association were handled."""
        self._pings += 1
        self._pinged_at = self._context.now()
        self._context.stamps.compare()
        self._sent_at[self._pings] = self._context.stamps.now()
        if len(self._sent_at) > _UNANSWERED:
            del self._sent_at[next(iter(self._sent_at))]
        return Ping(n=self._pings, sent=self._context.wall_ns(), handled=handled)

    def answer(self, ping: Ping) -> Pong | None:
        """Record the delay of a ping of the peer, and return the answer, or None if the peer pings too often."""
        if self.clock.offset is not None:
            delay = (self._context.wall_ns() - ping.sent) / 1e9 + self.clock.offset
            self.ping_delay = min(max(0.0, delay), _LONGEST_PING)
        if not self._answers.take(1, self._context.now()):
            return None
        now = self._context.wall_ns()
        self._context.stamps.compare()
        return Pong(n=ping.n, sent=ping.sent, received=now, answered=now, shift=self._context.stamps.shift)

    def answered(self, pong: Pong) -> None:
        self.answered_pings = max(self.answered_pings, min(pong.n, self._pings))  # a peer may name any number
        self.clock.add(pong.sent, pong.received, pong.answered, self._context.wall_ns())
        # The ping has the time on the wall clock, which may be set; that on the clock of stamps was kept here.
        if (sent := self._sent_at.pop(pong.n, None)) is not None:
            self.stamps.add(sent, pong.received + pong.shift, pong.answered + pong.shift, self._context.stamps.now())
