"""The topics that a link carries, by its measured figures."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest
from tests.support.wording import says

from rsb_extras.bench.presentation import JudgingText, capacity, in_words, judge
from rsb_extras.bench.results import Load, Point, Run
from rsb_extras.bench.suite import loads_of_all

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import Snapshot


def point(
    size: int, rate: float | None, transport: str = "tcp", limit: str = "loss", direction: str = "transmit"
) -> Point:
    best = None if rate is None else Run(size, 100, 100, rate, 1.0, 2.0)
    return Point(transport, direction, size, Run(size, 10, 10, 100.0, 1.0, 2.0), None, best, limit)  # type: ignore[arg-type]


MEASURED = [point(1_000, 10_000.0), point(100_000, 1_000.0), point(1_000_000, 40.0)]


@pytest.mark.parametrize(
    ("size", "rate"),
    [
        (100, 10_000.0),  # below the measured sizes: the same cost
        (1_000, 10_000.0),
        (10_000, math.sqrt(10_000.0 * 1_000.0)),  # in the middle of logarithms
        (1_000_000, 40.0),
        (4_000_000, 10.0),  # above: by the byte
    ],
)
def test_capacity_between_and_beyond_sizes_that_were_measured(size: int, rate: float) -> None:
    assert capacity(MEASURED, size) == pytest.approx(rate)


def test_lack_of_time_says_nothing_silence_does() -> None:
    assert capacity([*MEASURED, point(10_000, None, limit="time")], 10_000) == pytest.approx(capacity(MEASURED, 10_000))
    assert capacity([point(1_000, 100.0), point(10_000, None)], 10_000) == 0.0
    assert capacity([], 1.0) == 0.0


def test_topics_are_carried_just_so_or_not() -> None:
    camera = Load("/camera", 1_000_000, 30.0, "tcp", "transmit")
    close = Load("/depth", 1_000_000, 38.0)
    points = Load("/points", 4_000_000, 11.0)
    judged = judge([camera, close, points], MEASURED)
    assert [each.verdict for each in judged] == ["carried", "barely", "not"]
    assert judged[0].share == pytest.approx(0.75)


@pytest.mark.parametrize("limit", ["time", "leave"])
def test_untried_is_not_too_much(limit: str) -> None:
    measured = [point(1_000, 100.0), point(100_000, 10.0, limit=limit)]
    loads = [Load("/a", 1_000, 95.0), Load("/b", 100_000, 10.0), Load("/c", 100_000, 11.0), Load("/d", 1_000_000, 2.0)]
    judged = judge(loads, measured)
    assert [each.verdict for each in judged] == ["barely", "carried", "unknown", "unknown"]
    assert [each.at_most for each in judged] == [False, True, True, True]
    words = in_words(judged, "this link", together=True)
    assert not any(says(line, JudgingText.CARRIES_NONE) or "Together" in line for line in words)
    assert any("/c" in line and "/d" in line and says(line, JudgingText.UNKNOWN) for line in words)


def test_topic_is_judged_by_its_transport_and_direction() -> None:
    both = [point(1_000, 100.0), point(1_000, 1_000.0, "udp"), point(1_000, 10.0, direction="receive")]
    assert judge([Load("/a", 1_000, 90.0, "tcp", "transmit")], both)[0].verdict == "barely"
    assert judge([Load("/a", 1_000, 90.0, "tcp", "receive")], both)[0].verdict == "not"
    assert judge([Load("/a", 1_000, 90.0)], both)[0].transport == "udp"
    assert judge([Load("/a", 1_000, 90.0, "bluetooth")], both)[0].transport == "udp"


def test_verdict_names_carried_and_not_carried() -> None:
    judged = judge([Load("/camera", 1_200_000, 20.0), Load("/points", 9_000_000, 10.0)], MEASURED)
    first, *_ = in_words(judged, "this link", together=True)
    assert "/camera" in first.partition(", not ")[0]
    assert "/points" in first.partition(", not ")[2]


def test_what_is_too_much_together_is_said() -> None:
    loads = [Load(f"/camera{number}", 1_000_000, 20.0) for number in range(3)]
    judged = judge(loads, MEASURED)
    assert any("150 %" in line for line in in_words(judged, "this link", together=True))
    assert not any("150 %" in line for line in in_words(judged, "this link", together=False))


def snapshot(role: str, link: str) -> Snapshot:
    """A bridge with one topic of 1 kB at 10 Hz."""
    spec = SimpleNamespace(kind="topic", topic="/scan", direction="transmit")
    figures = {"expected_rate": None, "rate": 10.0, "bytes_per_second": 1e4, "ledger": SimpleNamespace(delivered=1)}
    route = SimpleNamespace(spec=spec, link=link, topic=f"/{role}/scan", transport="tcp", **figures)
    return cast("Snapshot", SimpleNamespace(role=role, routes=[route]))


def test_topic_between_two_local_bridges_is_one() -> None:
    assert len(loads_of_all([snapshot("client", "robot1"), snapshot("server", "robot1")])) == 1
    assert len(loads_of_all([snapshot("server", "robot1"), snapshot("server", "robot2")])) == 2
    assert len(loads_of_all([snapshot("client", "robot1"), snapshot("client", "robot1")])) == 2
