"""Figures stay within their columns."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.console.scripted import LINK, route

from rsb_bridge.model.snapshot import WaySnapshot
from rsb_console.notation import formats
from rsb_console.notation.ascii_signs import to_ascii


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (formats.thousands(1234567), "1 234 567"),
        (formats.hertz(0.0), "0"),
        (formats.hertz(49.83), "49.8"),
        (formats.hertz(1000.2), "1000"),
        (formats.expected(10.0), "10"),
        (formats.expected(0.5), "0.5"),
        (formats.beside_rate(route("/scan", expected_rate=10.0)), "/10"),
        (formats.beside_rate(route("/scan", expected_rate=None)), ""),
        (formats.beside_rate(route("/scan", expected_rate=None, max_rate=1.0)), "≤1"),
        (formats.beside_rate(route("/scan", expected_rate=0.98, max_rate=1.0)), "≤1"),
        (formats.beside_rate(route("/scan", expected_rate=5.0, max_rate=5.0)), "≤5"),
        (formats.beside_rate(route("/scan", expected_rate=10.0, max_rate=50.0)), "/10"),
        (to_ascii("1.0" + formats.beside_rate(route("/scan", expected_rate=1.0, max_rate=1.0))), "1.0<1"),
        (formats.rate_by_name(route("/scan", expected_rate=10.0, max_rate=50.0)), "usual: 10 Hz"),
        (formats.rate_by_name(route("/scan", expected_rate=1.0, max_rate=1.0)), "limit: 1 Hz"),
        (formats.byte_rate(412), "412 B/s"),
        (formats.byte_rate(9_990), "10 kB/s"),
        (formats.byte_rate(312_000), "312 kB/s"),
        (formats.byte_rate(3_100_000), "3.1 MB/s"),
        (formats.span(12e-6), "12 µs"),
        (formats.span(0.0031), "3.1 ms"),
        (formats.span(1.25), "1.25 s"),
        (formats.span(6.3e7), "729 d"),
        (formats.age(0.04), "0.0s"),
        (formats.age(31), "31s"),
        (formats.age(720), "12m"),
        (formats.age(3 * 86400), "3d"),
        (formats.clock(724), "00:12:04"),
        (formats.next_attempt(LINK), ""),
        (formats.next_attempt(replace(LINK, retry_in=1.2)), "retry 1 in 2 s"),
        (formats.next_attempt(replace(LINK, attempts=3, retry_in=0.0)), "retry 4 now"),
        (formats.waits(LINK, 100.9), ""),
        (formats.waits(replace(LINK, association_ends=145.1), 100.9), "topics and calls wait 45 s more"),
        (formats.counted(1, "topic"), "1 topic"),
        (formats.counted(0, "topic"), "0 topics"),
        (formats.byte_count(0), "0 B"),
        (formats.byte_count(999), "999 B"),
        (formats.byte_count(29_392_800), "29 MB"),
        (formats.byte_count(3_120_000_000_000), "3.1 TB"),
    ],
)
def test_words(made: str, expected: str) -> None:
    assert made == expected


@pytest.mark.parametrize(
    ("other", "text"), [("wwan0", "via wlan0 (wwan0 ready)"), ("wlan0", "via wlan0 (10.8.0.1 ready)")]
)
def test_way_over_the_same_device_is_told_by_its_address(other: str, text: str) -> None:
    used = WaySnapshot("192.168.1.10", "wlan0", is_used=True, is_ready=False)
    ways = (used, WaySnapshot("10.8.0.1", other, is_used=False, is_ready=True))
    assert formats.via(replace(LINK, via="wlan0", ways=ways)) == text


@pytest.mark.parametrize(
    ("made", "most", "width"), [(formats.age, 1e7, 5), (formats.hertz, 99_999, 5), (formats.byte_rate, 999e6, 8)]
)
@settings(deadline=None)
@given(st.data())
def test_figures_fit_their_columns(made: Callable[[float], str], most: float, width: int, data: st.DataObject) -> None:
    assert len(made(data.draw(st.floats(0, most)))) <= width
