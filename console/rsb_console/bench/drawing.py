"""Draws the highest lossless rates over the sizes: in a terminal, and as SVG. Both axes are logarithmic."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import escape

from rsb_console.look.formats import byte_count, byte_rate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_console.bench.results import Point

_MARKS = "*o+x#@"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's, which people who see fewer colours tell apart."""
_HEIGHT = 14
_LEFT = 11
_NARROWEST = 40


class Line(NamedTuple):
    """One transport and direction: bytes, and bytes a second that are carried without a loss."""

    name: str
    points: tuple[tuple[float, float], ...]


def lines_of(points: Sequence[Point]) -> list[Line]:
    """The lines to draw."""
    two_ways = len({each.direction for each in points}) > 1
    found: dict[str, list[tuple[float, float]]] = {}
    for each in points:
        if each.best is not None:
            name = f"{each.transport} {each.direction}" if two_ways else each.transport
            found.setdefault(name, []).append((each.size, each.best.rate * each.size))
    return [Line(name, tuple(sorted(values))) for name, values in found.items()]


class _Axis:
    """Where a value stands between the ends of an axis, as a share."""

    def __init__(self, values: Sequence[float]) -> None:
        self.low = math.floor(math.log10(min(values)))
        self.high = max(math.ceil(math.log10(max(values))), self.low + 1)

    def at(self, value: float) -> float:
        return (math.log10(value) - self.low) / (self.high - self.low)

    @property
    def ticks(self) -> list[float]:
        return [10.0**power for power in range(self.low, self.high + 1)]


def _axes(lines: Sequence[Line]) -> tuple[_Axis, _Axis]:
    return tuple(_Axis([point[at] for line in lines for point in line.points]) for at in (0, 1))  # type: ignore[return-value]


def in_terminal(points: Sequence[Point], width: int) -> list[str]:
    """Lines of plain characters, at most `width` wide."""
    lines = lines_of(points)
    if not lines:
        return []
    x, y = _axes(lines)
    columns = max(width, _NARROWEST) - _LEFT - 1
    cells = [[" "] * columns for _ in range(_HEIGHT)]
    for mark, line in zip(_MARKS * len(lines), lines, strict=False):
        for size, rate in line.points:
            column, row = round(x.at(size) * (columns - 1)), round(y.at(rate) * (_HEIGHT - 1))
            cells[row][column] = mark if cells[row][column] == " " else "&"
    labels = {round(y.at(tick) * (_HEIGHT - 1)): byte_rate(tick) for tick in y.ticks}
    drawn = [f"{labels.get(row, ''):>{_LEFT - 1}} |{''.join(cells[row])}".rstrip() for row in reversed(range(_HEIGHT))]
    below = [" "] * (_LEFT + columns + 1)
    end = 0
    for tick in x.ticks:
        text = byte_count(round(tick))
        begin = min(_LEFT + 1 + round(x.at(tick) * (columns - 1)), len(below) - len(text))
        if begin >= end:
            below[begin : begin + len(text)] = text
            end = begin + len(text) + 1
    legend = "   ".join(f"{mark} {line.name}" for mark, line in zip(_MARKS * len(lines), lines, strict=False))
    return [
        "Carried without a loss, bytes a second by the size of a message",
        *drawn,
        f"{'':>{_LEFT - 1}} +{'-' * columns}",
        "".join(below).rstrip(),
        f"{'':>{_LEFT}} {legend}{'   & several' if any('&' in row for row in cells) else ''}",
    ]


def as_svg(points: Sequence[Point], title: str) -> str:
    """The same as an SVG document; without points, one that says so."""
    lines = lines_of(points)
    wide, high, left, top, right, bottom = 720, 420, 90, 40, 130, 50
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" font-family="sans-serif" font-size="12">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{wide}" height="{high}" fill="white"/>',
        f'<text x="{left}" y="24" font-size="15">{escape(title)}</text>',
    ]
    if not lines:
        return "\n".join([*parts, f'<text x="{left}" y="{high // 2}">nothing was measured</text>', "</svg>"]) + "\n"
    x, y = _axes(lines)
    inner_wide, inner_high = wide - left - right, high - top - bottom

    def place(size: float, rate: float) -> tuple[float, float]:
        return left + x.at(size) * inner_wide, top + (1 - y.at(rate)) * inner_high

    for tick in x.ticks:
        at, _ = place(tick, y.ticks[0])
        parts.append(f'<line x1="{at:.1f}" y1="{top}" x2="{at:.1f}" y2="{high - bottom}" stroke="#ddd"/>')
        parts.append(
            f'<text x="{at:.1f}" y="{high - bottom + 18}" text-anchor="middle">{byte_count(round(tick))}</text>'
        )
    for tick in y.ticks:
        _, at = place(x.ticks[0], tick)
        parts.append(f'<line x1="{left}" y1="{at:.1f}" x2="{wide - right}" y2="{at:.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 8}" y="{at + 4:.1f}" text-anchor="end">{byte_rate(tick)}</text>')
    parts.append(
        f'<text x="{left + inner_wide / 2:.0f}" y="{high - 10}" text-anchor="middle">size of a message; '
        "bytes a second that are carried without a loss</text>"
    )
    for number, line in enumerate(lines):
        colour = _COLOURS[number % len(_COLOURS)]
        places = [place(*point) for point in line.points]
        path = " ".join(f"{across:.1f},{down:.1f}" for across, down in places)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{across:.1f}" cy="{down:.1f}" r="4" fill="{colour}"/>' for across, down in places]
        down = top + 16 + 20 * number
        parts.append(f'<rect x="{wide - right + 14}" y="{down - 9}" width="10" height="10" fill="{colour}"/>')
        parts.append(f'<text x="{wide - right + 30}" y="{down}">{escape(line.name)}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"
