"""Loss of packets on a path, and its fault on both sides."""

from __future__ import annotations

from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from rsb_bridge.link.path_watch import PathWatch, steady
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import PacketCounts, Stream, StreamHandler
from rsb_bridge.wire.records import PathRecord

PING = 0.002
PACKET = 1400


class Path:
    """One side's watch of a path with a control connection and one data stream."""

    def __init__(self, seed: int = 1, peer: str = "robot1") -> None:
        self.events: list[EventCode] = []
        self.now, self._answered = 100.0, 0
        self._pings = SimpleNamespace()
        link: Any = SimpleNamespace(
            context=SimpleNamespace(now=lambda: self.now),
            keepalive=self._pings,
            log_of_peer=lambda level, code, text, *, link_status: self.events.append(code),
            peer_name=peer,
            routes={},
        )
        self.watch = PathWatch(link)
        self.control, self.data = Stream(StreamHandler()), Stream(StreamHandler())
        self.told: list[tuple[LinkCause, str] | None] = []
        self._random = Random(seed)
        self._packets = dict.fromkeys((self.control, self.data), PacketCounts(0, 0, 0, 0, 0))

    def pass_(
        self,
        seconds: int,
        *,
        loss: float = 0.0,
        rate: int = 20,
        ping: float = PING,
        answers: bool = True,
        quiet: float = 0.5,
        held: bool = False,
        stalled: int = 0,
        vanish: bool = False,
    ) -> list[Stream]:
        """Let time pass; return the streams to open again.

        Args:
            seconds: s.
            loss: share of the packets that are lost.
            rate: packets/s of the data stream.
            ping: s of a ping.
            quiet: s since something came.
            held: nothing comes on the control connection any more.
            stalled: bytes of the data stream that the kernel sends again and again, or 0.
        """
        stale: list[Stream] = []
        for _ in range(seconds):
            self.now += 1.0
            self._answered += answers
            for stream, packets in ((self.control, 2), (self.data, 0 if stalled else rate)):
                lost = sum(self._random.random() < loss for _ in range(packets))
                before = self._packets[stream]
                again = int(stalled > 0 and stream is self.data)
                self._packets[stream] = PacketCounts(
                    before.sent + packets + again,
                    before.lost + lost + again,
                    before.acknowledged + PACKET * (packets - lost),
                    stalled if stream is self.data else 0,
                    2 if stalled and stream is self.data else 0,
                )
            vars(self._pings).update(
                round_trip=ping, answered_pings=self._answered, quiet=quiet, control_is_silent=held
            )
            stale += self.watch.observe(self.control, dict(self._packets), (), large_vanish=vanish)
            fault = self.watch.fault
            self.told.append(None if fault is None else (fault.cause, fault.text))
        return stale

    @property
    def cause(self) -> LinkCause | None:
        return None if self.watch.fault is None else self.watch.fault.cause

    def changes(self) -> int:
        """Count the changes of the fault's text."""
        return sum(one != other for one, other in zip(self.told, self.told[1:], strict=False))


@pytest.mark.parametrize("seed", range(8))
def test_lossy_path_has_one_cause_and_steady_figure(seed: int) -> None:
    path = Path(seed)
    path.pass_(30)
    assert (path.cause, path.watch.loss.share) == (None, 0.0)
    path.pass_(6, loss=0.3)
    assert path.cause is LinkCause.LOSSY
    path.pass_(60, loss=0.3)
    assert {each and each[0] for each in path.told[36:]} == {LinkCause.LOSSY}
    assert path.changes() <= 3
    assert path.watch.loss.share is not None
    assert 0.2 < path.watch.loss.share < 0.4
    path.pass_(25)
    assert path.cause is None
    assert path.events == [EventCode.LINK_PATH_FAULT, EventCode.LINK_PATH_RESTORED]


def test_pings_alone_show_a_lossy_path() -> None:
    path = Path()
    path.pass_(20, loss=0.3, rate=0)
    assert path.cause is LinkCause.LOSSY


def test_some_loss_is_a_figure_and_no_fault() -> None:
    path = Path()
    path.pass_(60, loss=0.02)
    assert set(path.told) == {None}
    assert path.watch.loss.share


def test_a_gap_is_no_lossy_path() -> None:
    path = Path()
    path.pass_(20)
    path.pass_(3, loss=1.0)
    path.pass_(1, loss=0.6, rate=200)  # a window is sent again
    path.pass_(30)
    assert set(path.told) == {None}


def test_what_full_link_loses_is_not_path() -> None:
    path = Path()
    path.pass_(10)
    path.pass_(30, loss=0.3, ping=PING + 0.04)
    assert set(path.told) == {None}


def test_path_that_became_longer_shows_its_losses_again() -> None:
    path = Path()
    path.pass_(10)
    path.pass_(4200, rate=0, ping=PING + 0.04)
    path.pass_(30, loss=0.3, ping=PING + 0.04)
    assert path.cause is LinkCause.LOSSY


def test_lossy_path_that_fills_stays_lossy() -> None:
    path = Path()
    path.pass_(10, loss=0.3)
    path.pass_(10, loss=0.3, ping=PING + 0.04)
    assert path.cause is LinkCause.LOSSY
    path.pass_(20, loss=0.3, ping=PING + 0.04)
    assert path.cause is None


def test_new_stream_proves_loss_of_large_packets() -> None:
    path = Path()
    path.pass_(4, rate=0)
    assert not path.pass_(5, stalled=PACKET)
    assert path.cause is LinkCause.LARGE_PACKETS
    assert path.watch.next_record() == PathRecord(lost=path.watch.loss.share, large=True)
    path.pass_(12)
    assert path.cause is None


def test_stalled_stream_of_large_packets_opens_anew() -> None:
    path = Path()
    path.pass_(4)
    assert path.pass_(5, stalled=PACKET)[:1] == [path.data]
    assert path.cause is None


def test_large_datagrams_vanish_while_small_ones_are_answered() -> None:
    path = Path()
    path.pass_(5, vanish=True, rate=0)
    assert path.cause is LinkCause.LARGE_PACKETS


@pytest.mark.parametrize("stalled", [700, 100_000])
def test_a_cut_cable_never_blames_large_packets(stalled: int) -> None:
    path = Path()
    path.pass_(4, rate=0)
    path.pass_(2, stalled=stalled, answers=False, loss=1.0)
    path.pass_(8, stalled=stalled, answers=False, loss=1.0, quiet=3.0)
    assert {each and each[0] for each in path.told} == {None, LinkCause.SILENT}
    assert path.events == [], "the end of the link tells it"


def test_held_connection_is_a_silent_path() -> None:
    path = Path()
    path.pass_(8, answers=False, held=True)
    assert path.cause is LinkCause.SILENT


def test_a_lossy_path_never_blames_large_packets() -> None:
    path = Path()
    path.pass_(20, loss=0.3)
    path.pass_(20, loss=0.3, stalled=PACKET)
    assert path.cause is LinkCause.LOSSY


def test_small_messages_that_stall_prove_nothing() -> None:
    path = Path()
    path.pass_(4, rate=0)
    assert not path.pass_(20, stalled=700)
    assert path.cause is None


def test_both_sides_tell_the_same() -> None:
    here, there = Path(1), Path(2, "the server")
    here.pass_(10, loss=0.3)
    there.pass_(10)
    record = here.watch.next_record()
    assert record is not None
    assert here.watch.next_record() is None
    there.watch.take_record(record)
    assert (here.cause, there.cause) == (LinkCause.LOSSY, LinkCause.LOSSY)
    assert here.watch.fault is not None
    assert there.watch.fault is not None
    share = f"{round(100 * record.lossy)} % of packets are lost"
    assert here.watch.fault.text.startswith(f"{share} to robot1")
    assert there.watch.fault.text.startswith(f"{share} from the server")


def test_next_connection_soon_after_has_losses_of_last() -> None:
    path = Path()
    path.pass_(10, loss=0.3)
    path.watch.disconnected()
    assert path.cause is None
    path.pass_(1, loss=0.3)
    assert path.cause is LinkCause.LOSSY
    path.watch.disconnected()
    path.now += 60.0
    path.pass_(1)
    assert path.cause is None


@pytest.mark.parametrize(
    ("shown", "share", "then"),
    [(0.0, 0.31, 0.3), (0.3, 0.22, 0.3), (0.3, 0.5, 0.5), (0.0, 0.06, 0.06), (0.06, 0.07, 0.06)],
)
def test_shown_share_changes_with_clear_difference_only(shown: float, share: float, then: float) -> None:
    assert steady(shown, share) == pytest.approx(then)
