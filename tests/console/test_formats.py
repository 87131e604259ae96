"""Figures stay within their columns."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rsb_console.look import formats

ANY = st.floats(0, 1e7)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (formats.thousands(1234567), "1 234 567"),
        (formats.hertz(0.0), "0"),
        (formats.hertz(49.83), "49.8"),
        (formats.hertz(1000.2), "1000"),
        (formats.expected(10.0), "10"),
        (formats.expected(0.5), "0.5"),
        (formats.byte_rate(412), "412 B/s"),
        (formats.byte_rate(9_990), "10 kB/s"),
        (formats.byte_rate(312_000), "312 kB/s"),
        (formats.byte_rate(3_100_000), "3.1 MB/s"),
        (formats.span(12e-6), "12 µs"),
        (formats.span(0.0031), "3.1 ms"),
        (formats.span(1.25), "1.25 s"),
        (formats.age(0.04), "0.0s"),
        (formats.age(31), "31s"),
        (formats.age(720), "12m"),
        (formats.age(3 * 86400), "3d"),
        (formats.clock(724), "00:12:04"),
    ],
)
def test_words(made: str, expected: str) -> None:
    assert made == expected


@settings(deadline=None)
@given(ANY)
def test_ages_fit_their_column(seconds: float) -> None:
    assert len(formats.age(seconds)) <= 5


@settings(deadline=None)
@given(st.floats(0, 99_999))
def test_rates_fit_their_column(rate: float) -> None:
    assert len(formats.hertz(rate)) <= 5


@settings(deadline=None)
@given(st.floats(0, 999e6))
def test_byte_rates_fit_the_status_bar(rate: float) -> None:
    assert len(formats.byte_rate(rate)) <= 8
