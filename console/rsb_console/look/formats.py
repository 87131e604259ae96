"""Figures in words: short, aligned, and with the unit an operator expects."""

from __future__ import annotations

import time


def thousands(count: int) -> str:
    """``7 134``."""
    return f"{count:,}".replace(",", " ")


def hertz(rate: float) -> str:
    """A rate without its unit, in at most five characters: ``0.2``, ``49.8``, ``1000``."""
    return f"{rate:.0f}" if rate >= 100 or rate == 0 else f"{rate:.1f}"


def expected(rate: float) -> str:
    """A rate that is asked for: ``10``, ``0.5``, ``1000``."""
    return f"{rate:.3g}" if rate < 1000 else f"{rate:.0f}"


def milliseconds(seconds: float) -> str:
    """A latency in ms without the unit, in at most five characters: ``0.3``, ``3.1``, ``1204``."""
    value = max(0.0, seconds * 1e3)  # below 0 is the clock offset's error, not a latency
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def byte_rate(bytes_per_second: float) -> str:
    """In at most eight characters: ``412 B/s``, ``9.4 kB/s``, ``312 kB/s``, ``3.1 MB/s``."""
    if bytes_per_second < 1e3:
        return f"{bytes_per_second:.0f} B/s"
    value, unit = (bytes_per_second / 1e6, "MB/s") if bytes_per_second >= 1e6 else (bytes_per_second / 1e3, "kB/s")
    return f"{value:.1f} {unit}" if value < 9.95 else f"{value:.0f} {unit}"


def kilobytes(bytes_per_second: float) -> str:
    """kB/s without the unit, in at most six characters."""
    value = bytes_per_second / 1e3
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def span(seconds: float) -> str:
    """A duration in two or three figures: ``12 µs``, ``3.1 ms``, ``1.25 s``."""
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} µs"
    if seconds < 1:
        return f"{seconds * 1e3:.1f} ms"
    return f"{seconds:.2f} s"


def latency(seconds: float, uncertainty: float | None) -> str:
    """As `span`; one that the clock offset's error has made negative: ``<0.4 ms``."""
    if seconds > 0:
        return span(seconds)
    return f"<{span(uncertainty)}" if uncertainty else span(0.0)


def age(seconds: float) -> str:
    """How long ago, in at most five characters: ``0.1s``, ``31s``, ``12m``, ``3h``, ``5d``."""
    if seconds < 10:
        return f"{max(seconds, 0.0):.1f}s"
    if seconds < 100:
        return f"{seconds:.0f}s"
    for size, unit in ((86400, "d"), (3600, "h"), (60, "m")):
        if seconds >= size:
            return f"{seconds / size:.0f}{unit}"
    return f"{seconds:.0f}s"


def clock(seconds: float) -> str:
    """A duration as ``00:12:04``."""
    whole = max(0, int(seconds))
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def time_of_day(epoch: float) -> str:
    """Local time as ``02:31:07``."""
    return time.strftime("%H:%M:%S", time.localtime(epoch))
