"""The history depth of each publisher of a latched topic: how many messages it keeps for late joiners.

DDS does not announce the depth of a publisher's history, but a new subscription shows it: the history comes first. If
it begins with message 6 and the newest is 10, the publisher keeps five. If it begins with message 1, the publisher
keeps at least as many as have come. So a short-lived second subscription (a probe) shows the depth.

A publisher that never pauses publishes while it is probed. Only what it published before the probe's first message came
may be history, which shows its depth within few messages. Each message is sent with the most that its publisher may
keep, so that the peer keeps a growing history in one publisher, whose order a late joiner gets. The peer cannot drop a
part of that. So a second message waits until a probe shows that its publisher keeps more than one, as few do, but for
0.3 s at most. So do a history that is sent again, and a burst of more than 16 messages.

A killed publisher's history is withdrawn once a newcomer, or the first publisher of a new opening, has shown that it is
silent. A late joiner on the far side may have heard it last, so the newest message of the other publishers is sent
again, over a cut of the link, too.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.model.qos import AUTO_DEPTH, QUEUE_BYTES
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.silent_publishers import SilentPublishers
from rsb_bridge.wire.headers import MOST_RESENDS, HistoryHeader, publisher_id, resends_of

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Mapping, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Subscription

# Where these were measured: bench/README.md, *Constants of latched topics*. The others are round figures.
_SETTLES_AFTER = 0.1  # s without a message of a publisher: its history has come
_HELD_FOR = 0.3  # s that messages wait for a probe; a publisher that has not been quiet for so long is busy
_HELD = LATCHED_DEPTH  # messages of a publisher that wait
_HEARD_WITHIN = 10.0  # s for what may have published before this side started, and may never have
_WITHDRAWN_AFTER = 3.0  # s until the peer has closed a silent publisher's history: it looks once a second
_ENDED_AFTER = 0.5  # s: the graph is looked at 1 s after its last change, and may have lost a publisher for a moment

_PROBES_FOR = 1.0  # s until a probe ends that has not got what it waits for
_PROBE_SETTLES_AFTER = 0.05  # s after all that it waits for: what overtook that in the other subscription has come, too
_PROBES_EACH_UNTIL = 16  # number of a message, up to which each is probed for; later every doubling of the number is
_MOST_TRIES = 5  # probes in a row that show no depth: each has the publisher send its history again
_MEANWHILE = 100  # messages during a probe, up to which it bounds the depth from above

Bounds: TypeAlias = tuple[int, int]
"""The least and the most messages that a publisher may keep."""


class Taken(NamedTuple):
    """Counts of the messages that a latched topic's subscription brought, for the ledger.

    Attributes:
        new: the peer does not have these, and this opening had not brought them before.
        again: of the new ones, those from an earlier opening.
        known: never taken by this route; the peer has them from an earlier process of this side.
    """

    new: int
    again: int
    known: int


class Sample(NamedTuple):
    """A message of a latched topic."""

    header: HistoryHeader
    message: RawMessage
    replayed: bool  # it comes from its publisher's history rather than live


@dataclass(slots=True)
class _Publisher:
    """One publisher. Times are in s."""

    taken: int  # the newest number that the peer has, or that was emitted or is held
    began: float  # when `first` came
    latest: float  # when `newest` came
    flows_since: float  # when the first message came after the last silence of `_SETTLES_AFTER`
    first: int = 0  # the first message number that this subscription brought, or 0 before the first message
    newest: int = 0
    settled: bool = False  # its whole history has come
    at_least: int = 1  # bounds of the depth
    at_most: int = LATCHED_DEPTH
    bounded: bool = False  # these come from an earlier opening, so that no message is held for better ones
    probe_at: int = 2  # the next probe begins at the message with this number
    tries: int = 0  # probes in a row that did not show the depth
    released: bool = False  # its first messages have been held for as long as they may be
    held: deque[tuple[RawMessage, bool]] = field(default_factory=deque)  # each with whether it was replayed
    held_size: int = 0
    held_until: float = 0.0  # for a probe
    # Of a topic with a lifespan, the newest live messages' numbers, and when they came.
    arrivals: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=LATCHED_DEPTH))
    source: int = 0  # ns since the epoch, when its newest message was published
    gone_since: float | None = None  # when it left the graph, or None while it is there
    is_ahead: bool = False  # its clock is: a message came before it was published

    @property
    def exact(self) -> bool:
        """Whether no further probe helps: the depth is found, or the publisher never pauses or shows no history."""
        return self.at_least >= self.at_most or self.tries >= _MOST_TRIES

    def awaits_depth(self, number: int) -> bool:
        """Whether a message waits for the depth: the peer would keep it and the ones before together."""
        if self.exact or self.bounded or (self.released and (self.is_busy or self.tries)):
            return False
        return self.at_least == 1 or self.at_least < _PROBES_EACH_UNTIL < number - self.first + 1

    @property
    def is_busy(self) -> bool:
        return self.latest - self.flows_since >= _HELD_FOR - _SETTLES_AFTER

    def hold(self, message: RawMessage, now: float, *, replayed: bool) -> None:
        if not self.held:
            self.held_until = now + _HELD_FOR
        self.held.append((message, replayed))
        self.held_size += len(message.payload)

    def wants_probe(self) -> bool:
        has_history = self.settled or self.first == 1  # with message 1, no earlier ones come
        return has_history and not self.exact and self.newest >= self.probe_at and self.gone_since is None


@dataclass(slots=True)
class KnownPublishers:
    """The publishers of a latched topic as a route knows them from one opening to the next; histories keep it up.

    Attributes:
        taken: the newest number that was taken, by publisher.
        resent: how often a publisher's history was sent again: the peer knows it under the id that follows from this.
        bounds: of depths, by publisher: a DDS publisher's depth never changes.
        resends: ns since the epoch, when the newest message was published that is to be sent again, or 0.
    """

    taken: dict[bytes, int] = field(default_factory=dict)
    resent: dict[bytes, int] = field(default_factory=dict)
    bounds: dict[bytes, Bounds] = field(default_factory=dict)
    resends: int = 0


class Histories:
    """Emits the messages of a latched topic, each with its publisher's history depth. It belongs to the I/O loop."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        probe: Callable[[Callable[[Sequence[RawMessage]], None]], Subscription],
        emit: Callable[[list[Sample]], None],
        found: Callable[[], None],
        again: Callable[[Sequence[RawMessage]], None],
        *,
        depth: int,
        lifespan: float,
        known: Mapping[bytes, int],
        remembered: KnownPublishers,
    ) -> None:
        """Begin without publishers.

        Args:
            probe: subscribes a second time, with a receiver of its messages on the loop; may raise RosError.
            emit: gets the messages, on the loop, in order for each publisher.
            found: called after `present` has changed.
            again: gets messages that are to be sent though they were taken before; it hands them to `receive`.
            depth: history depth that an operator has set for all publishers, or 0 to find it out.
            lifespan: s after which publishers on either side forget a message, or 0 for never.
            known: the newest number that the peer has, by publisher.
            remembered: of the route's earlier openings.
        """
        self._loop = loop
        self._open_probe = probe
        self._emit = emit
        self._found = found
        self._depth = min(depth, LATCHED_DEPTH)
        self._lifespan = lifespan
        self._known = dict(known)
        self._kept_there = known.keys()
        self._remembered = remembered
        self._bounds_before = {} if depth else dict(remembered.bounds)
        self._in_graph: Collection[bytes] = ()
        self._is_subscribed = False
        self._publishers: dict[bytes, _Publisher] = {}
        self._mute: Collection[bytes] = ()
        self._silent = SilentPublishers(loop, probe, self._withdraw, again)
        self._resends: asyncio.TimerHandle | None = None
        self._hears_until = loop.time() + _HEARD_WITHIN
        self._probe: _Probe | None = None
        self._timer: asyncio.TimerHandle | None = None

    def present(self, gids: Collection[bytes], mute: Collection[bytes] = ()) -> dict[bytes, int]:
        """Forget publishers that have ended, and return the depth of each other one that is not silent, or 0.

        A publisher that the graph has lost just now is still present. The peer drops the histories of the others, so
        if one returns, its whole history is sent.

        Args:
            gids: of the publishers that the graph has.
            mute: those of them that give a new subscription no history, alive or not (`Endpoint.is_durable`).
        """
        self._in_graph, self._mute = gids, mute
        left = {*gids, *self._forget_gone(gids)} - self._silent.silent
        depths = {gid: each.at_most for gid, each in self._publishers.items() if each.exact}
        return {self._id(gid): depths.get(gid, 0) for gid in left}

    @property
    def resends(self) -> int:
        """When the newest message was published, ns since the epoch, if it will be sent again, or 0."""
        return self._remembered.resends

    # --- messages

    def receive(self, batch: Sequence[RawMessage]) -> Taken:
        """Take messages from ROS, oldest first."""
        now = self._loop.time()
        new, again, known, samples = 0, 0, 0, list[Sample]()
        for message in batch:
            publisher = self._seen(message, now)
            is_first = note_taken(self._remembered.taken, message)
            # DDS hands over the whole history to each new subscription. The peer has this message, or will get it.
            if message.number and message.number <= publisher.taken:
                known += is_first
                continue
            new += 1
            again += not is_first
            publisher.taken = max(publisher.taken, message.number)
            replayed = not publisher.settled
            if not message.number:  # it gets one here, so that a message that overtakes it on the way stays the newest
                publisher.taken += 1
            # The first one is never held: its publisher keeps at least one.
            is_awaited = publisher.awaits_depth(message.number) and not (self._depth or self._lifespan)
            if message.number > 1 and (publisher.held or is_awaited):
                publisher.hold(message, now, replayed=replayed)
            else:
                number = message.number or publisher.taken
                samples.append(self._sample(publisher, message, number, replayed=replayed))
        if samples:
            self._emit(samples)
        self._work()
        return Taken(new, again, known)

    def resubscribed(self) -> None:
        """Expect all histories again, because the subscription was reopened."""
        self._is_subscribed = True
        for publisher in self._publishers.values():
            publisher.first = 0
            publisher.settled = publisher.exact
            publisher.flows_since = self._loop.time()
            publisher.arrivals.clear()
        self._silent.go_on()
        if self._remembered.resends and self._resends is None:
            self._send_newest_later(self._remembered.resends)

    def unsubscribed(self) -> None:
        """Keep no further subscription open while the topic is not subscribed to, and hold nothing up for a probe."""
        self._is_subscribed = False
        self._silent.close()
        self._end_probe()
        for publisher in self._publishers.values():
            self._release(publisher)

    def _forget_gone(self, present: Collection[bytes]) -> Collection[bytes]:
        """Forget publishers that have ended; return the others that have been heard."""
        now = self._loop.time()
        if self._bounds_before:
            here = {publisher_id(gid) for gid in present}
            self._bounds_before = {gid: each for gid, each in self._bounds_before.items() if gid in here}
        for gid in [gid for gid in self._remembered.taken if gid not in present and gid not in self._publishers]:
            del self._remembered.taken[gid]
        for gid, publisher in tuple(self._publishers.items()):
            if gid in present:
                publisher.gone_since = None
                continue
            if publisher.gone_since is None:
                publisher.gone_since = now
            # A publisher that still sends is there, even if the graph has lost it.
            if now - max(publisher.latest, publisher.gone_since) > _ENDED_AFTER:
                del self._publishers[gid]
        here = {*present, *self._publishers}
        for gid in self._remembered.resent.keys() - here:
            del self._remembered.resent[gid]
        self._silent.forget_gone(here)
        return self._publishers

    def close(self) -> int:
        """Stop emitting messages, and return how many were held."""
        self._end_probe()
        self._silent.close()
        for timer in (self._timer, self._resends):
            if timer is not None:
                timer.cancel()
        self._timer = self._resends = None
        held = sum(len(publisher.held) for publisher in self._publishers.values())
        known = {gid: each for gid, each in self._publishers.items() if each.at_most < LATCHED_DEPTH}
        bounds = {publisher_id(gid): (each.at_least, each.at_most) for gid, each in known.items()}
        self._remembered.bounds = self._bounds_before | bounds
        self._publishers.clear()
        return held

    def _seen(self, message: RawMessage, now: float) -> _Publisher:
        publisher = self._publishers.get(message.gid)
        if publisher is None:
            known = self._known.pop(self._id(message.gid), 0)
            publisher = self._publishers[message.gid] = _Publisher(known, now, now, now)
            if bounds := self._bounds_before.pop(publisher_id(message.gid), None):
                publisher.at_least, publisher.at_most = bounds
                publisher.bounded = True
            self._doubt_others(message)
        if not publisher.first:
            publisher.first, publisher.began = message.number, now
        if message.number >= publisher.newest:
            publisher.newest, publisher.source = message.number, message.source
        publisher.is_ahead = publisher.is_ahead or message.source > message.stamp
        if now - publisher.latest > _SETTLES_AFTER:
            publisher.flows_since = now
        publisher.latest = now
        if self._lifespan and publisher.settled and not publisher.exact:
            publisher.arrivals.append((message.number, now))
        return publisher

    def _sample(self, publisher: _Publisher, message: RawMessage, number: int, *, replayed: bool) -> Sample:
        depth = self._depth or (publisher.at_most if message.number else AUTO_DEPTH)
        return Sample(HistoryHeader(self._id(message.gid), number, depth), message, replayed)

    def _id(self, gid: bytes) -> bytes:
        return publisher_id(gid, self._resent(gid))

    def _resent(self, gid: bytes) -> int:
        """Return how often a publisher's history was sent again, perhaps by an earlier process of this side."""
        resent = self._remembered.resent.get(gid)
        if resent is None:
            resent = self._remembered.resent[gid] = resends_of(gid, self._kept_there) or 0
        return resent

    # --- killed publishers

    def _doubt_others(self, newcomer: RawMessage) -> None:
        """Ask whether the other publishers answer: a newcomer may replace a killed one, also of an earlier opening."""
        if not newcomer.number or self._lifespan:  # the peer's publishers forget what has expired, too
            return
        unheard = {gid for gid in self._in_graph if self._id(gid) in self._known}
        if others := (self._publishers.keys() | unheard) - {newcomer.gid, *self._mute}:
            self._silent.ask(newcomer.gid, others)

    @property
    def _unheard(self) -> bool:
        """Whether a publisher that may have published has sent nothing in this opening."""
        return not self._publishers.keys() | self._silent.silent >= {*self._in_graph} - {*self._mute}

    def _withdraw(self) -> None:
        for gid in self._silent.silent:
            self._publishers.pop(gid, None)
            self._known.pop(self._id(gid), None)
        if self._resends is not None:
            self._resends.cancel()
        newest = max((each.source for each in self._publishers.values()), default=0)
        self._hears_until = self._loop.time() + _HEARD_WITHIN
        self._send_newest_later(max(newest, self._remembered.resends))
        self._found()

    def _send_newest_later(self, newest: int) -> None:
        self._remembered.resends = newest
        self._resends = self._loop.call_later(_WITHDRAWN_AFTER, self._send_newest_again, newest)

    def _send_newest_again(self, newest_then: int) -> None:
        """Send the history of the newest message again, unless a newer message has come since the withdrawal.

        It gets another id, because the peer leaves out messages that it knows.

        Args:
            newest_then: ns since the epoch, when the newest message at the withdrawal was published.
        """
        self._resends, self._remembered.resends = None, 0
        gid, newest = max(self._publishers.items(), key=lambda item: item[1].source, default=(b"", None))
        # After a restart of this side, the newest may not have been heard yet.
        is_early = self._loop.time() < self._hears_until
        if is_early and self._unheard and (newest is None or newest.source < newest_then):
            self._send_newest_later(newest_then)
            return
        if newest is None or newest.source > newest_then:
            self._found()
            return
        # The peer drops what has the former id, so that id stays until there is something to replace it. One that is
        # asked may have to be withdrawn before.
        if self._silent.asks or not self._silent.hear_again(gid):
            self._send_newest_later(newest_then)
            return
        self._remembered.resent[gid] = (self._resent(gid) + 1) % MOST_RESENDS
        newest.taken = newest.first = 0
        newest.settled = newest.exact
        self._found()

    # --- depths

    def _work(self) -> None:
        """Settle complete histories, release held messages, start a probe if one is needed, and set the timer."""
        now = self._loop.time()
        due: list[float] = []
        wanted: dict[bytes, int] = {}
        for gid, publisher in self._publishers.items():
            # Without numbers, or with a given depth, a probe has no question.
            if not publisher.first or self._depth:
                continue
            releases_at = max(publisher.began + _HELD_FOR, publisher.held_until)
            if len(publisher.held) >= _HELD or publisher.held_size > QUEUE_BYTES:
                releases_at = now
            if not publisher.settled:
                settles_at = min(publisher.latest + _SETTLES_AFTER, releases_at)
                publisher.settled = now >= settles_at
                due += [] if publisher.settled else [settles_at]
            if publisher.held:
                if now >= releases_at or not publisher.awaits_depth(publisher.newest):
                    self._release(publisher)
                else:
                    due.append(releases_at)
            publisher.released = publisher.released or now >= releases_at
            if publisher.wants_probe():
                wanted[gid] = publisher.newest
        # One at a time, for all publishers: each second subscription has DDS send all histories once more. Messages
        # that are held do not wait for publishers that may have gone without a word.
        if self._probe is not None and any(self._publishers[gid].held and self._probe.is_past(gid) for gid in wanted):
            self._finish_probe(self._probe)
        if wanted and self._probe is None and self._is_subscribed:
            self._start_probe(wanted, now)
        if self._probe is not None:
            due.append(self._probe.until)
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(min(due), self._timed_out) if due else None

    def _timed_out(self) -> None:
        self._timer = None
        if self._probe is not None and self._loop.time() >= self._probe.until:
            self._finish_probe(self._probe)
        self._work()

    def _start_probe(self, wanted: dict[bytes, int], now: float) -> None:
        probe = self._probe = _Probe(wanted, now + _PROBES_FOR)

        def receive(batch: Sequence[RawMessage]) -> None:
            if self._probe is probe:
                probe.receive(batch, self._loop.time())
                self._work()

        try:
            probe.subscription = self._open_probe(receive)
        except RosError:
            probe.until = now  # finish at once, as a probe that got nothing

    def _finish_probe(self, probe: _Probe) -> None:
        self._end_probe()
        found = False
        for gid, target in probe.wanted.items():
            publisher, awaited = self._publishers.get(gid), gid not in probe.found and self._loop.time() < probe.until
            if publisher is not None and not publisher.exact and not awaited:
                self._judge(publisher, target, probe.found.get(gid, _NOTHING))
                found = found or publisher.exact
        if found:
            self._found()

    def _end_probe(self) -> None:
        if self._probe is not None and self._probe.subscription is not None:
            self._probe.subscription.close()
        self._probe = None

    def _judge(self, publisher: _Publisher, target: int, found: _Found) -> None:
        """Judge the depth by what a probe found that began when `target` was the newest message."""
        first, last = found.first, found.last
        # Nothing is overwritten yet, so this is only a lower bound.
        if first == 1 and last >= target:
            publisher.tries = 0
            publisher.at_least = max(publisher.at_least, min(target, publisher.at_most))
            each = target < _PROBES_EACH_UNTIL and not self._lifespan
            publisher.probe_at = target + 1 if each else 2 * target
        else:
            publisher.tries += 1
            if self._may_have_expired(publisher, first - 1):
                publisher.probe_at = publisher.newest + 1  # until then a probe shows no more
            elif first > 1 and last >= target:
                # The newest message when the history was sent was one from `target` to `kept`.
                newest = max(publisher.newest, last)
                kept = newest if publisher.is_ahead else max(target, found.kept)
                if newest - target <= _MEANWHILE:
                    publisher.at_most = min(publisher.at_most, kept - first + 1)
                publisher.at_least = min(max(publisher.at_least, target - first + 1), publisher.at_most)
        if not publisher.awaits_depth(publisher.newest):
            self._release(publisher)

    def _may_have_expired(self, publisher: _Publisher, number: int) -> bool:
        """Whether a message may be kept no longer because of its age rather than the depth."""
        if not self._lifespan:
            return False
        came = next((at for each, at in publisher.arrivals if each == number), None)
        return came is None or self._loop.time() - came > self._lifespan / 2

    def _release(self, publisher: _Publisher) -> None:
        """Emit the held messages."""
        held, publisher.held, publisher.held_size = publisher.held, deque(), 0
        samples = [self._sample(publisher, each, each.number, replayed=replayed) for each, replayed in held]
        if samples:
            self._emit(samples)


@dataclass(slots=True)
class _Found:
    """Messages of one publisher that a probe got."""

    first: int  # the first number
    came: int  # ns since the epoch, when that came
    last: int = 0  # the last number
    kept: int = 0  # the last number that its history may have had, unless its clock is ahead


_NOTHING = _Found(0, 0)


@dataclass(slots=True)
class _Probe:
    """A second subscription and its findings."""

    wanted: dict[bytes, int]  # number to wait for, by publisher
    until: float  # s, when to stop waiting
    subscription: Subscription | None = None
    found: dict[bytes, _Found] = field(default_factory=dict)  # what has come, by publisher
    is_complete: bool = False

    def is_past(self, gid: bytes) -> bool:
        """Whether it only waits for publishers other than this one."""
        return not self.is_complete and self.found.get(gid, _NOTHING).last >= self.wanted.get(gid, 0)

    def receive(self, batch: Sequence[RawMessage], now: float) -> None:
        """Take messages. Once all wanted numbers have come, the probe ends a moment later, even if more come."""
        for message in batch:
            found = self.found.get(message.gid)
            if found is None:
                found = self.found[message.gid] = _Found(message.number, message.stamp)
            found.last = message.number
            # Messages published after the first one had come are no history.
            if message.source <= found.came:
                found.kept = message.number
        if not self.is_complete and all(
            self.found.get(gid, _NOTHING).last >= number for gid, number in self.wanted.items()
        ):
            self.is_complete = True
            self.until = min(self.until, now + _PROBE_SETTLES_AFTER)


def note_taken(taken: dict[bytes, int], message: RawMessage) -> bool:
    """Note a message in the newest numbers that a route has taken, and return whether it is the first time."""
    before = taken.get(message.gid, 0)
    taken[message.gid] = max(before, message.number)
    return message.number > before or not message.number
