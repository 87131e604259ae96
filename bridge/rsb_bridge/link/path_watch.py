"""Measures the loss of packets on the path of a link: their share, and whether only large ones are lost.

Each side measures its own direction and reports it. TCP's losses are the kernel's repetitions, UDP's come from
receipts. Losses count only while no queue builds up on the path: a full link loses packets, too.

One stalled connection does not prove that large packets are lost, so a probe does. While pings are answered at once, a
stream that stalls is opened again. If its first, small packets pass and the large ones do not, the path loses large
packets. UDP's own probes are small and have the same addresses as its messages.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.channel.datagram_channel import DatagramSender
from rsb_bridge.link.extension import Extension
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.faults import PathFault, PathFaultText
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.telemetry.meters import Shortest
from rsb_bridge.transport.streams import PacketCounts, Stream
from rsb_bridge.wire.records import PathRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from rsb_bridge.link.base_link import BaseLink

# Numbers without a source are round figures. `bench.banners` counts how often banners change with them.
_FORGOTTEN_AFTER = 10.0  # s without a link after which it may go another way

# Of the share of lost packets.
_TICKS = 20  # over which it is averaged
_COUNTED = 10  # packets of a tick that count: a gap loses a whole window at once, and is not a lossy path
_ENOUGH, _LOSES_IN = 30, 4  # packets, and ticks with a loss, before a path counts as lossy
_LOSSY_ABOVE, _WHOLE_BELOW = 0.05, 0.02  # shares, the same as for a topic's messages (`rsb_bridge.telemetry.watches`)

# Of pings.
_PINGS = 3  # the last ones: one or two may be late by chance
# s, and part of the shortest ping of an hour, by which all of the last pings take longer if a queue has built up on the
# path. If only packets are lost, some pings meet no loss.
_QUEUE, _QUEUE_PART = 0.015, 0.25
_SILENT_AFTER = 2.5  # s without a byte, while pings come once a second

# Of large packets.
# Times in a row that the kernel has sent a stream's oldest bytes again. It gives the stream up after 6 s, of which the
# pings that have to be answered meanwhile take three.
_STALLED = 2
_LARGE = 1000  # bytes: fewer cross any path that carries pings
_SMALL_PASSED = 3  # pings that are answered while large packets are not
_LARGE_AGAIN_AFTER = 10.0  # s without a stalled stream after which large packets count as passing again
STALLED = "nothing gets through it, though pings are answered"  # why a stalled stream is opened again

_NOTHING = PacketCounts(0, 0, 0, 0, 0)


class PacketLoss:
    """The share of packets that one direction loses."""

    def __init__(self) -> None:
        self.share: float | None = None  # 0 to 1, or None if it is unknown
        self.lossy = 0.0  # the same, rounded and steady, while it is a fault, else 0
        self._ticks: deque[tuple[int, float]] = deque(maxlen=_TICKS)  # packets that count, and the part of them lost
        self._skipped = 0

    def skip(self) -> None:
        """Leave a second out; after many in a row, begin again."""
        self._skipped += 1
        if self._skipped >= _TICKS:
            self.clear()

    def count(self, sent: int, lost: int) -> None:
        """Count the packets of a second."""
        self._skipped = 0
        counted = min(sent, _COUNTED)
        if lost and not any(part for _, part in self._ticks):
            self._ticks.clear()  # the share is that of the time since losses began
        self._ticks.append((counted, counted * min(1.0, lost / sent) if sent else 0.0))
        packets = sum([each for each, _ in self._ticks])
        if packets < _ENOUGH:
            self.share = None
            return
        self.share = share = sum([part for _, part in self._ticks]) / packets
        if self.lossy:  # it ends at a lower share than it begins at, as a banner would flicker
            self.lossy = 0.0 if share < _WHOLE_BELOW else steady(self.lossy, share)
        elif share >= _LOSSY_ABOVE and sum(part > 0 for _, part in self._ticks) >= _LOSES_IN:
            self.lossy = steady(0.0, share)

    def clear(self) -> None:
        self.share, self.lossy = None, 0.0
        self._skipped = 0
        self._ticks.clear()


def steady(shown: float, share: float) -> float:
    """Return the share to show after `shown`: it changes only if the new one differs clearly, as a banner shows it."""
    if shown and abs(share - shown) <= max(0.02, 0.3 * shown):
        return shown
    return round(share, 2 if share < 0.1 else 1)


class PathWatch(Extension):
    """Watches the path of one link."""

    def __init__(self, link: BaseLink) -> None:
        self._link = link
        self.loss = PacketLoss()  # of the packets from here
        self._observed_at = float("-inf")
        self._begin()

    def _begin(self) -> None:
        self.fault: PathFault | None = None
        self.into = PathRecord()  # the peer's record of the direction to here
        self._large = False  # large packets from here are lost
        self._stalled_at = float("-inf")
        self._probe: tuple[int, int] | None = None  # answered pings and lost packets when the probe began
        self._counts: dict[object, PacketCounts] = {}  # of each carrier, when it last made progress
        self._pings: deque[float] = deque(maxlen=_PINGS)
        self._shortest = Shortest()
        self._record = self._sent = PathRecord()
        self._logged = False

    def disconnected(self) -> None:
        self._begin()  # except for the losses: they count for the next connection, if that comes soon

    suspend = disconnected

    def tick(self) -> None:
        link = self._link
        if link.control is None:
            return
        counts = {each: each.packets() for each in link.carriers() if isinstance(each, Stream)}
        # First, which of them it may be: what a class is an instance of takes longer, and there may be hundreds.
        by_datagrams = [route.half for route in link.routes.values() if not route.transport.reliable]
        channels = [half.carried.channel for half in by_datagrams]
        stalled = self.observe(
            link.control.stream,
            {stream: packets for stream, packets in counts.items() if packets is not None},
            [channel for channel in channels if isinstance(channel, DatagramSender)],
            large_vanish=any(half.facts.large_vanish for half in by_datagrams),
        )
        for stream in stalled:
            stream.abort(STALLED)

    def observe(
        self,
        control: Stream,
        streams: Mapping[Stream, PacketCounts],
        senders: Collection[DatagramSender],
        *,
        large_vanish: bool,
    ) -> list[Stream]:
        """Observe the path, once a second; return the streams that are stalled, to be opened again.

        Args:
            streams: the packets of all streams, as far as they are known.
            senders: the channels that send datagrams.
            large_vanish: none of the last large datagrams has arrived, while probes of their sockets are answered.
        """
        pings, now, peer = self._link.keepalive, self._link.context.now(), self._link.peer_name
        if now - self._observed_at > _FORGOTTEN_AFTER:  # after a shorter gap, the losses of the last connection count
            self.loss.clear()
        self._observed_at = now
        sent, lost, passed = self._gained(streams, senders)
        queues = self._queues(pings.round_trip, now)
        if queues or not passed:  # a full link, or a gap
            self.loss.skip()
        else:
            self.loss.count(sent, lost)
        own = streams[control].lost if control in streams else 0
        large = {
            stream: counts
            for stream, counts in streams.items()
            if stream is not control and counts.tries >= _STALLED and counts.waiting >= _LARGE
        }
        stalled = self._probe_sizes(large, pings.answered_pings, own, now, vanish=large_vanish)
        share = self.loss.share
        # Losses of any packets explain that large ones are lost: a lower MTU would be the wrong advice.
        lost_share, lossy = None if share is None else round(share, 2), self.loss.lossy
        self._record = PathRecord(lost_share, lossy, self._large and not lossy)
        silent = ""
        if pings.quiet > _SILENT_AFTER:
            silent = PathFaultText.SILENT(peer=peer)
        elif pings.control_is_silent:
            silent = PathFaultText.HELD(peer=peer)
        self._judge(silent)
        return stalled

    def _gained(
        self, streams: Mapping[Stream, PacketCounts], senders: Collection[DatagramSender]
    ) -> tuple[int, int, bool]:
        """Return the packets sent and lost of the carriers that make progress, and whether any does.

        A stalled stream counts once it goes on: until then, one that carries large packets may be all that is lost.
        """
        # Datagrams are lost in full buffers, too. So they count only where TCP's losses are unknown.
        counts = dict[object, PacketCounts](streams.items()) or {each: each.packets() for each in senders}
        before, self._counts = self._counts, {}
        sent = lost = 0
        passed = False
        for carrier, now in counts.items():
            then = before.get(carrier, _NOTHING)
            if now.tries or now.acknowledged <= then.acknowledged:
                self._counts[carrier] = then
                continue
            self._counts[carrier] = now
            passed = True
            sent += max(0, now.sent - then.sent)
            lost += max(0, now.lost - then.lost)
        return sent, lost, passed

    def _queues(self, round_trip: float | None, now: float) -> bool:
        """Whether a queue has built up on the path, by the newest ping (s)."""
        if round_trip is None:
            return False
        self._pings.append(round_trip)
        shortest = self._shortest.add(round_trip, now)
        return min(self._pings) - shortest > max(_QUEUE, _QUEUE_PART * shortest)

    def _probe_sizes(
        self, stalled: Mapping[Stream, PacketCounts], answered: int, lost: int, now: float, *, vanish: bool
    ) -> list[Stream]:
        """Find out whether large packets are lost; return the streams to open again for that.

        Args:
            stalled: the streams whose large packets the kernel sends again and again.
            answered: pings so far.
            lost: packets of the control connection so far.
        """
        if not stalled and not vanish:
            self._probe = None
            if now - self._stalled_at > _LARGE_AGAIN_AFTER:
                self._large = False
            return []
        self._stalled_at = now
        if self.loss.lossy or self._probe is None or self._probe[1] != lost:
            self._probe = answered, lost  # small packets are lost as well
            return []
        if answered - self._probe[0] < _SMALL_PASSED:
            return []
        fresh = [stream for stream, counts in stalled.items() if counts.acknowledged < _LARGE]
        self._large |= vanish or bool(fresh)
        # Large packets have crossed these: perhaps a firewall has forgotten the connection.
        return [stream for stream in stalled if stream not in fresh]

    def take_record(self, record: PathRecord) -> None:
        """Take the peer's record of the direction to here."""
        self.into = record
        # Only `observe` knows whether the peer is silent; until then, it stays as it was.
        self._judge(self.fault.text if self.fault is not None and self.fault.cause is LinkCause.SILENT else "")

    def _judge(self, silent: str) -> None:
        """Find the present fault; `silent` says that nothing comes, or is empty."""
        before, peer = self.fault, self._link.peer_name
        out, into = self._record, self.into
        if lossy := max(out.lossy, into.lossy):
            way = _way(out=out.lossy > 0, into=into.lossy > 0)
            text = PathFaultText.LOSSY(share=f"{lossy:.0%}".replace("%", " %"), way=way, peer=peer)
            self.fault = PathFault(LinkCause.LOSSY, text)
        elif silent:
            self.fault = PathFault(LinkCause.SILENT, silent)
        elif out.large or into.large:
            way = _way(out=out.large, into=into.large)
            self.fault = PathFault(LinkCause.LARGE_PACKETS, PathFaultText.LARGE_PACKETS(way=way, peer=peer))
        else:
            self.fault = None
        if self.fault != before:
            for route in tuple(self._link.routes.values()):
                route.judge_again()  # so that their verdicts agree with the link's
        if self.fault is None and self._logged:
            self._logged = False
            text = PathFaultText.GONE(peer=peer)
            self._link.log_of_peer(Level.INFO, EventCode.LINK_PATH_RESTORED, text, link_status=True)
        elif self.fault is None or self.fault.cause is LinkCause.SILENT:  # which the link's end tells
            return
        elif before is None or before.cause is not self.fault.cause or not self._logged:
            self._logged = True
            self._link.log_of_peer(Level.WARNING, EventCode.LINK_PATH_FAULT, self.fault.text, link_status=True)

    def next_record(self) -> PathRecord | None:
        """Return the record for the peer, or None if it has not changed since the last one."""
        if self._record == self._sent:
            return None
        self._sent = self._record
        return self._record


def _way(*, out: bool, into: bool) -> str:
    return "to and from" if out and into else "to" if out else "from"
