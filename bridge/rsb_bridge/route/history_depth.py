"""The history depth of each publisher of a latched topic: how many messages it keeps for late joiners.

DDS does not announce the depth of a publisher's history, but a new subscription shows it: the history comes first. If
it begins with message 6 and the newest is 10, the publisher keeps five. If it begins with message 1, the publisher
keeps at least as many as have come. So messages of a publisher with an unknown depth are held back for a moment, until
a short-lived second subscription (a probe) has shown which of them the publisher keeps.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.wire.headers import HistoryHeader, publisher_id

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Mapping, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Subscription

_SETTLES_AFTER = 0.1  # s without a message of a publisher: its history has come
_SETTLES_AT_LATEST = 1.0  # s
_HELD_SIZE = 32 << 20  # bytes of one publisher's messages
_PROBES_FOR = 1.0  # s
_PROBE_SETTLES_AFTER = 0.05  # s
_PROBES_EACH_UNTIL = 16
"""Up to this number each message is probed for, later every doubling of the number: a probe replays the history."""
_MOST_TRIES = 5
_LAST_NUMBER = 2**63 - 1
_FORGOTTEN_AFTER = 20.0
"""Seconds a publisher must be gone; longer than the peer keeps its history, whose numbers may be given here."""
_UNNUMBERED_DEPTH = 10


class Sample(NamedTuple):
    """A message of a latched topic.

    Attributes:
        header: its publisher, number and history depth.
        message: message from ROS.
        replayed: whether it comes from its publisher's history rather than live.
    """

    header: HistoryHeader
    message: RawMessage
    replayed: bool


@dataclass(slots=True)
class _Publisher:
    """One publisher.

    Attributes:
        first: the first message number that this subscription brought, or 0 before the first message.
        newest: the newest number seen.
        taken: the newest number that the peer has, or that was emitted or is held.
        began: s, when `first` came.
        latest: s, when `newest` came.
        settled: whether its whole history has come.
        depth: best estimate of its depth.
        exact: whether the depth is final.
        probe_at: number of the next message that needs a probe.
        tries: probes in a row that did not show the depth.
        at_least: lower bound of the depth from those probes.
        at_most: upper bound of the depth from those probes.
        held: messages held until the depth is clear, each with whether it was replayed.
        held_size: bytes of `held`.
        gone_since: time (s) when it left the graph, or None while it is there.
    """

    taken: int
    began: float
    latest: float
    first: int = 0
    newest: int = 0
    settled: bool = False
    depth: int = 1
    exact: bool = False
    probe_at: int = 0
    tries: int = 0
    at_least: int = 1
    at_most: int = _LAST_NUMBER
    held: deque[tuple[RawMessage, bool]] = field(default_factory=deque)
    held_size: int = 0
    gone_since: float | None = None


class Histories:
    """Emits the messages of a latched topic, each with its publisher's history depth. It belongs to the I/O loop."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        probe: Callable[[Callable[[Sequence[RawMessage]], None]], Subscription],
        emit: Callable[[list[Sample]], None],
        *,
        depth: int,
        known: Mapping[bytes, int],
    ) -> None:
        """Begin.

        Args:
            loop: the I/O loop.
            probe: subscribes a second time, with a receiver of its messages on the loop; may raise RosError.
            emit: gets the messages, on the loop, in order for each publisher.
            depth: history depth that an operator has set for all publishers, or 0 to find it out.
            known: the newest number that the peer has, by publisher.
        """
        self._loop = loop
        self._open_probe = probe
        self._emit = emit
        self._depth = min(depth, LATCHED_DEPTH)
        self._known = dict(known)
        self._publishers: dict[bytes, _Publisher] = {}
        self._probe: _Probe | None = None
        self._timer: asyncio.TimerHandle | None = None

    # --- messages

    def take(self, batch: Sequence[RawMessage]) -> int:
        """Take messages from ROS, oldest first.

        Returns:
            The number of new ones: the peer does not have them, and they were not taken before.
        """
        now = self._loop.time()
        new, samples = 0, list[Sample]()
        for message in batch:
            publisher = self._seen(message, now)
            if message.number and message.number <= publisher.taken:
                continue
            new += 1
            publisher.taken = max(publisher.taken, message.number)
            depth = self._depth_of(publisher, message.number)
            if not message.number:  # it gets one here, so that a message that overtakes it on the way stays the newest
                publisher.taken += 1
            if depth:
                number = message.number or publisher.taken
                samples.append(_sample(message, number, depth, replayed=not publisher.settled))
            else:
                publisher.held.append((message, not publisher.settled))
                publisher.held_size += len(message.payload)
        if samples:
            self._emit(samples)
        self._work()
        return new

    def resubscribed(self) -> None:
        """Expect all histories again, because the subscription was reopened."""
        for publisher in self._publishers.values():
            publisher.first = 0
            publisher.settled = publisher.exact

    def look(self, present: Collection[bytes]) -> None:
        """Forget publishers that are gone.

        Args:
            present: ids of the publishers in the graph.
        """
        now = self._loop.time()
        for gid, publisher in tuple(self._publishers.items()):
            if gid in present:
                publisher.gone_since = None
                continue
            if publisher.gone_since is None:
                publisher.gone_since = now
            if publisher.settled and publisher.held:  # a probe would find nothing
                self._conclude(publisher, publisher.newest)
            elif now - max(publisher.latest, publisher.gone_since) > _FORGOTTEN_AFTER:
                del self._publishers[gid]

    def close(self) -> int:
        """Stop emitting messages.

        Returns:
            The number of messages that were held.
        """
        self._end_probe()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        held = sum(len(publisher.held) for publisher in self._publishers.values())
        self._publishers.clear()
        return held

    def _seen(self, message: RawMessage, now: float) -> _Publisher:
        publisher = self._publishers.get(message.gid)
        if publisher is None:
            known = self._known.pop(publisher_id(message.gid), 0)
            publisher = self._publishers[message.gid] = _Publisher(known, now, now)
        if not publisher.first:
            publisher.first, publisher.began = message.number, now
        publisher.newest = max(publisher.newest, message.number)
        publisher.latest = now
        return publisher

    def _depth_of(self, publisher: _Publisher, number: int) -> int:
        """Return the depth to emit a message with, or 0 if it is not known yet."""
        if self._depth:
            return self._depth
        if not number:
            return _UNNUMBERED_DEPTH
        if publisher.exact:
            return publisher.depth
        if publisher.settled and not publisher.held and number < publisher.probe_at:
            publisher.depth = number
            return number
        return 0

    # --- depths

    def _work(self) -> None:
        """Settle complete histories, start a probe if one is needed, and set the timer for the next step."""
        now = self._loop.time()
        due: list[float] = []
        wanted: dict[bytes, int] = {}
        for gid, publisher in self._publishers.items():
            if publisher.settled or not publisher.first:
                pass
            elif now >= (settles_at := _settles_at(publisher)):
                self._settle(publisher)
            else:
                due.append(settles_at)
            if publisher.settled and publisher.held:
                wanted[gid] = publisher.newest
        if wanted and self._probe is None:
            self._start_probe(wanted, now)
        if self._probe is not None:
            due.append(self._probe.until)
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(min(due), self._timed_out) if due else None

    def _timed_out(self) -> None:
        self._timer = None
        if self._probe is not None and self._loop.time() >= self._probe.until:
            self._finish_probe()
        self._work()

    def _settle(self, publisher: _Publisher) -> None:
        """Note that a publisher's history has come. If it is message 1 alone, the depth is at least 1."""
        publisher.settled = True
        if publisher.newest == 1:
            self._release(publisher, 1)

    def _start_probe(self, wanted: dict[bytes, int], now: float) -> None:
        probe = self._probe = _Probe(wanted, now + _PROBES_FOR)
        try:
            probe.subscription = self._open_probe(self._probed)
        except RosError:
            probe.until = now  # finish at once, as a probe that got nothing

    def _probed(self, batch: Sequence[RawMessage]) -> None:
        if self._probe is not None:
            self._probe.take(batch, self._loop.time())
            self._work()

    def _finish_probe(self) -> None:
        probe = self._probe
        self._end_probe()
        if probe is None:
            return
        for gid, target in probe.wanted.items():
            publisher = self._publishers.get(gid)
            if publisher is not None:
                self._judge(publisher, target, probe.first.get(gid, 0), probe.last.get(gid, 0))

    def _end_probe(self) -> None:
        if self._probe is not None and self._probe.subscription is not None:
            self._probe.subscription.close()
        self._probe = None

    def _judge(self, publisher: _Publisher, target: int, first: int, last: int) -> None:
        """Judge the depth by a probe that began when `target` was the newest message and got `first` to `last`."""
        if first == 1 and last >= target:
            publisher.tries = 0
            publisher.depth, publisher.exact = min(target, LATCHED_DEPTH), target >= LATCHED_DEPTH
            publisher.probe_at = target + 1 if target <= _PROBES_EACH_UNTIL else 2 * target
            self._release(publisher, target)
            while publisher.held and publisher.held[0][0].number < publisher.probe_at:
                publisher.depth = publisher.held[0][0].number
                self._release(publisher, publisher.depth)
            return
        newest = max(publisher.newest, last)
        publisher.tries += 1
        if first > 1 and last >= target:
            # The newest message when the history was sent was one from `target` to `newest`.
            publisher.at_least = max(publisher.at_least, target - first + 1)
            publisher.at_most = min(publisher.at_most, newest - first + 1)
        if publisher.at_least == publisher.at_most or publisher.tries >= _MOST_TRIES:
            self._conclude(publisher, newest)

    def _conclude(self, publisher: _Publisher, newest: int) -> None:
        """Fix the depth at the present estimate; too high only if the publisher never pauses or shows no history."""
        publisher.depth = min(publisher.at_most, newest - publisher.first + 1, LATCHED_DEPTH)
        publisher.exact = True
        self._release(publisher, newest)

    def _release(self, publisher: _Publisher, newest: int) -> None:
        """Emit the held messages up to a number."""
        samples = []
        while publisher.held and publisher.held[0][0].number <= newest:
            message, replayed = publisher.held.popleft()
            publisher.held_size -= len(message.payload)
            samples.append(_sample(message, message.number, publisher.depth, replayed=replayed))
        if samples:
            self._emit(samples)


class _Probe:
    """A second subscription and its findings.

    Attributes:
        wanted: number to wait for, by publisher.
        until: time (s) at which to stop waiting.
        first: the first number seen, by publisher.
        last: the last number seen, by publisher.
    """

    def __init__(self, wanted: dict[bytes, int], until: float) -> None:
        self.wanted = wanted
        self.until = until
        self.subscription: Subscription | None = None
        self.first: dict[bytes, int] = {}
        self.last: dict[bytes, int] = {}

    def take(self, batch: Sequence[RawMessage], now: float) -> None:
        """Take messages. Once all wanted numbers have come, the probe ends a moment later, after any late messages."""
        for message in batch:
            self.first.setdefault(message.gid, message.number)
            self.last[message.gid] = message.number
        if all(self.last.get(gid, 0) >= number for gid, number in self.wanted.items()):
            self.until = now + _PROBE_SETTLES_AFTER


def _settles_at(publisher: _Publisher) -> float:
    if publisher.held_size > _HELD_SIZE:
        return publisher.began
    return min(publisher.latest + _SETTLES_AFTER, publisher.began + _SETTLES_AT_LATEST)


def _sample(message: RawMessage, number: int, depth: int, *, replayed: bool) -> Sample:
    return Sample(HistoryHeader(publisher_id(message.gid), number, depth), message, replayed)
