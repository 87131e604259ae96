"""The measurements of a suite, their order and their time, on a clock that the test owns."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rsb_extras.bench.results import BenchReport
from rsb_extras.bench.suite import FULL, QUICK, Plan, Suite
from rsb_extras.bench.tests.simulated import SimulatedLink, SimulatedPlace


def measured(place: SimulatedPlace, plan: Plan = QUICK) -> BenchReport:
    report = BenchReport("a simulated link", "no machine")
    Suite(place, plan, report, lambda: place.time, lambda _: None).run()
    return report


def test_every_size_of_every_transport_is_measured() -> None:
    links = {"tcp": SimulatedLink(), "udp": SimulatedLink(5e6)}
    report = measured(SimulatedPlace(links))
    assert [(each.transport, each.size) for each in report.points] == [
        (name, size) for name in links for size in QUICK.sizes
    ]
    for each in report.points:
        capacity = links[each.transport].capacity(each.size)
        assert each.best is not None
        assert capacity / QUICK.close <= each.best.rate <= capacity
        assert each.best.wire_per_byte == pytest.approx(1 + 25 / each.size, rel=1e-3)
        assert each.full is not None
        assert not each.full.lossless
        assert each.added == (0.0, 0.0, 0.0)
    assert report.sides.keys() == links.keys()
    assert report.ended == "complete"


@pytest.mark.parametrize("plan", [QUICK, FULL])
def test_it_keeps_within_its_time(plan: Plan) -> None:
    place = SimulatedPlace({"tcp": SimulatedLink(), "udp": SimulatedLink()})
    report = measured(place, plan)
    assert place.time <= plan.most + 10 * plan.run
    assert len(report.points) == 2 * len(plan.sizes)


def test_latency_is_measured_at_each_carried_rate() -> None:
    report = measured(SimulatedPlace({"tcp": SimulatedLink(100e6, 12_000.0)}), replace(FULL, sizes=(256, 10_000)))
    assert [[run.rate for run in each.paced] for each in report.points] == [[1_000, 5_000, 10_000], [1_000, 5_000]]
    assert all(run.lossless for each in report.points for run in each.paced)


def test_without_wire_count_no_more_is_sent() -> None:
    class Blind(SimulatedLink):
        def wire(self, *_: float) -> None:  # type: ignore[override]
            return

    report = measured(SimulatedPlace({"tcp": Blind()}))
    assert all(point.best is not None and point.best.wire is None for point in report.points)


def test_each_transport_has_its_share_of_time() -> None:
    place = SimulatedPlace({"tcp": SimulatedLink(), "udp": SimulatedLink()})
    report = measured(place, replace(FULL, most=40.0, many=()))
    assert {each.transport for each in report.points} == {"tcp", "udp"}
    assert place.time < 60.0


def test_missing_transport_is_noted_others_go_on() -> None:
    links = {"tcp": SimulatedLink(), "bluetooth": SimulatedLink(), "udp": SimulatedLink()}
    report = measured(SimulatedPlace(links, fails=("bluetooth",)))
    assert {each.transport for each in report.points} == {"tcp", "udp"}
    assert len(report.notes) == 1


def test_stopping_peer_ends_run_and_keeps_its_results() -> None:
    links = {"tcp": SimulatedLink(), "udp": SimulatedLink()}
    report = measured(SimulatedPlace(links, stops=("udp",)), replace(QUICK, many=(1,)))
    assert report.ended == "stopped"
    assert {each.transport for each in report.points} == {"tcp"}
    assert report.many == []


def test_an_interrupt_leaves_what_was_measured() -> None:
    place, report = SimulatedPlace({"tcp": SimulatedLink()}), BenchReport("a link", "")

    def say(text: str) -> None:
        if "10 kB" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Suite(place, QUICK, report, lambda: place.time, say).run()
    assert [each.size for each in report.points] == [256]


def test_many_topics_are_measured_last() -> None:
    report = measured(SimulatedPlace({"tcp": SimulatedLink()}), replace(QUICK, many=(1, 500)))
    assert [each.count for each in report.many] == [1, 500]
