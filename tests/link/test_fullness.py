"""When a link is full, and what both sides know of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.inside import pretend_linked

from rsb_bridge.link.fullness import Asked, LinkFullness
from rsb_bridge.link.roles import ClientRole
from rsb_bridge.model.capacity import rates_text
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.wire.messages import Duplicate
from rsb_bridge.wire.records import FullRecord

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

CAMERA, SCAN = Asked("/camera", "/robot1/camera", 40e3), Asked("/scan", "/robot1/scan", 8e3)
ALL = 48e3


class Bed:
    def __init__(self) -> None:
        self.events: list[str] = []
        link: Any = SimpleNamespace(
            log=lambda level, code, text, *, link_status: self.events.append(code), peer_name="the server", routes={}
        )
        self.fullness = LinkFullness(link, SimpleNamespace())  # type: ignore[arg-type]

    def look(self, *arrived: float, full: bool = True) -> bool:
        for each in arrived:
            self.fullness.judge([SCAN, CAMERA], each, full=full)
        return self.fullness.out is not None


def test_link_is_full_while_less_arrives() -> None:
    bed = Bed()
    assert not bed.look(25e3, 25e3, 25e3)
    assert bed.look(25e3)
    out = bed.fullness.out
    assert out is not None
    assert (out.carried, out.asked, out.topics) == (25e3, ALL, ("/camera", "/scan"))
    assert bed.fullness.next_record() == FullRecord(25_000, 48_000, ("/robot1/camera", "/robot1/scan"))
    assert bed.fullness.next_record() is None
    assert bed.look(ALL, ALL, ALL, full=False)
    assert not bed.look(ALL, ALL, ALL, full=False)
    assert bed.fullness.next_record() == FullRecord()
    assert bed.events == [EventCode.LINK_FULL, EventCode.LINK_ROOM]


def test_map_that_does_not_fit_fills_link() -> None:
    """In each period there is a second in which more arrives than is asked for."""
    bed = Bed()
    for asked in [48e3, 24e3, 12e3, 6e3, 3e3] * 3:
        bed.fullness.judge([Asked("/map", "/map", asked)], 5e3, full=True)
    assert bed.fullness.out is not None
    assert bed.events == [EventCode.LINK_FULL]


@pytest.mark.parametrize("part", [0.0, 0.3, 0.7])
def test_a_stall_is_not_full(part: float) -> None:
    bed = Bed()
    bed.look(ALL, ALL, ALL)
    assert not any(
        bed.look(each)
        for each in (ALL, part * ALL, 0.0, 0.0, 0.0, 0.5 * ALL, 0.6 * ALL, 0.7 * ALL, 0.8 * ALL, 4 * ALL, ALL)
    )


def test_one_late_receipt_is_no_stall() -> None:
    assert Bed().look(25e3, 25e3, 25e3, 0.0, 50e3, 25e3)


def test_in_a_gap_the_last_figures_stay() -> None:
    bed = Bed()
    bed.look(25e3, 25e3, 25e3, 25e3)
    before = bed.fullness.out
    assert bed.look(*[0.0] * 8)
    assert bed.fullness.out == before
    assert bed.look(*[25e3] * 8)
    assert bed.events == [EventCode.LINK_FULL]


def test_it_has_room_once_nothing_is_asked() -> None:
    bed = Bed()
    bed.look(25e3, 25e3, 25e3, 25e3)
    for _ in range(4):
        bed.fullness.judge([], 0.0, full=False)
    assert bed.fullness.out is None


def test_nothing_says_that_it_is_full() -> None:
    assert not Bed().look(25e3, 25e3, 25e3, 25e3, 25e3, full=False)


def test_what_the_peer_says_is_brought_within_sense() -> None:
    bed = Bed()
    bed.fullness.take_record(FullRecord(float("nan"), float("inf"), ("/a",) * 9))
    assert bed.fullness.into is None or bed.fullness.into.carried <= bed.fullness.into.asked
    bed.fullness.take_record(FullRecord(5e3, 15e3, ("/camera",)))
    assert bed.fullness.warning
    bed.fullness.disconnected()
    assert bed.fullness.warning == ""


def test_the_time_without_a_link_does_not_count() -> None:
    watch = Bed().fullness
    for second in range(4):
        watch.sending.measure(1e5, second, second, full=True)
    watch.disconnected()
    watch.sending.measure(1e5, 1000.0, 1000.0, full=True)
    assert watch.sending.measure(1e5, 1001.0, 1001.0, full=True) == pytest.approx(1e5)


@pytest.mark.parametrize("asked", [15e3, 10.4e3, 1e3, 950.0, 1.04e6])
def test_link_that_carries_everything_is_not_full(asked: float) -> None:
    fullness = Bed().fullness
    carried = [0.33 * asked] * 8 + [2.0 * asked] * 2 + [asked] * 4
    seen = []
    for each in carried:
        fullness.judge([Asked("/camera", "/camera", asked)], each, full=each < asked)
        seen.append(fullness.out)
        if fullness.out is not None:
            part, _, whole = fullness.out.share.split()[1:4]
            assert float(part) < float(whole)
            assert fullness.out.carried < 0.95 * fullness.out.asked
    assert seen[7] is not None
    assert seen[11] is None, "four ticks after it has room"


def test_a_smaller_figure_has_a_smaller_text() -> None:
    assert [rates_text(14.9e3, 15e3), rates_text(15e3, 15e3)] == ["14 of 15 kB/s", "15 of 15 kB/s"]
    assert rates_text(1.1e6, 3e6) == "1.1 of 3.0 MB/s"
    assert rates_text(1, 400) == "1 of 400 B/s"
    assert rates_text(30e3, 68e6) == "0.03 of 68 MB/s"
    assert rates_text(0.0, 68e6) == "0 of 68 MB/s"


def test_a_warning_begins_when_the_link_becomes_full(loop: VirtualLoop, context: Context) -> None:
    link = ClientRole(context, {"robot1": ()}).links()[0]
    pretend_linked(link, SimpleNamespace())
    link.status.up(context.clock.steady())
    up = link.context.wall()
    loop.jump(100.0)
    assert (link.snapshot().warning_since, link.snapshot().fault_since) == (None, up)
    for carried in (5e3, 6e3, 7e3):
        link.fullness.take_record(FullRecord(carried, 15e3))
        assert link.snapshot().fault_since == pytest.approx(up + 100.0)
        loop.jump(10.0)
    link.handlers[Duplicate](Duplicate("10.0.0.9", "spare"))
    assert link.fault.cause() is LinkCause.NAME_TAKEN
    assert link.snapshot().fault_since == pytest.approx(up + 130.0)
    link.handlers[Duplicate](Duplicate())
    link.fullness.take_record(FullRecord())
    assert link.snapshot().fault_since == up


@pytest.mark.parametrize(("seconds", "words"), [(30, "30 s ahead of"), (-7200, "2 h behind"), (2, "")])
def test_clocks_that_differ_are_a_warning(seconds: int, words: str, context: Context) -> None:
    link = ClientRole(context, {"robot1": ()}).links()[0]
    pretend_linked(link, SimpleNamespace())
    link.status.up(context.clock.steady())
    there = seconds * 10**9
    link.clock.add(0, there + 10**6, there + 10**6, 2 * 10**6)
    assert words in link.fault.now().warning
    assert bool(link.fault.now().warning) is bool(words)
    assert link.fault.cause() is (LinkCause.CLOCKS_DIFFER if words else LinkCause.NONE)
