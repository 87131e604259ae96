"""The results of a benchmark for people: tables, a plot of the highest rates, and a verdict on topics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import escape

from rsb_bridge.feature_api import Wording, join_first
from rsb_console.notation.formats import byte_count, byte_rate, expected
from rsb_extras.bench.results import Judged, Load

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import Literal

    from rsb_extras.bench.results import BenchReport, Point

_LIMITS = {
    "loss": "",
    "sender": " (the sender's limit)",
    "leave": " (the peer's limit)",
    "time": " (time was up)",
}
_NONE = "-"
BARELY = 0.8
"""The share of the highest lossless rate from which on a topic has too little to spare. A round figure: two runs on
one machine differ (bench/README.md, Method)."""
USUAL = (
    Load("an IMU", 320, 200),
    Load("a laser scan", 9_000, 40),
    Load("a map", 400_000, 1),
    Load("a compressed camera image", 150_000, 30),
    Load("a depth image of 640 × 480", 614_400, 30),
    Load("a point cloud", 1_200_000, 10),
    Load("a raw camera image of 1920 × 1080", 6_220_800, 30),
)
"""Usual topics of robots, for a benchmark without a session."""
_NAMED = 8  # topics in a sentence; the others are counted. A round figure
_MARKS = "*o+x#@"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of Okabe and Ito, which colour-blind people can tell apart."""
_HEIGHT = 14
_LEFT = 11
_NARROWEST = 40


class JudgingText(Wording):
    """Verdicts on whether a link carries a session's topics."""

    CARRIES_NONE = "{over} does not carry {others}."
    UNKNOWN = "Too few rates were tried to judge whether {over} carries {topics}."


def lines_of(report: BenchReport) -> Iterator[str]:
    """Yield all tables, each with a line about it."""
    yield f"{report.over}; {report.machine}"
    if report.points:
        yield ""
        yield from _rates(report.points)
        yield ""
        yield from _latencies(report.points)
        if any(each.paced for each in report.points):
            yield ""
            yield from _latencies_by_rate(report.points)
    if report.sides:
        yield ""
        yield from _sides(report)
    if report.many:
        yield ""
        yield from _many(report)


def _rates(points: Sequence[Point]) -> Iterator[str]:
    yield "Highest rate without a loss; CPU of the two bridges in µs a message; wire bytes for each byte of payload;"
    yield "and what arrives when more is sent than is carried"
    rows: list[tuple[str, ...]] = [
        ("", "size", "msg/s", "bytes/s", "CPU sends", "receives", "wire", "too fast", "arrives", "")
    ]
    for each in points:
        best, full = each.best, each.full
        rows.append(
            (
                _way(each, points),
                byte_count(each.size),
                f"{best.rate:,.0f}" if best and best.rate >= 10 else f"{best.rate:.1f}" if best else _NONE,
                byte_rate(best.rate * each.size) if best else _NONE,
                *(
                    f"{side / best.sent * 1e6:,.0f}" if best and best.sent else _NONE
                    for side in (best.sides if best else (0, 0))
                ),
                f"{best.wire_per_byte:.3f}" if best and best.wire_per_byte else _NONE,
                f"{full.rate:,.0f}" if full else _NONE,
                f"{100 * full.received / full.sent:.0f} %" if full else _NONE,
                _LIMITS[each.limit],
            )
        )
    yield from _aligned(rows)


def _latencies(points: Sequence[Point]) -> Iterator[str]:
    added = any(each.base for each in points)
    what = "added by the bridge, compared with no bridge" if added else "from this end of the link to the other"
    yield f"Latency at a low rate, ms; {what}"
    rows: list[tuple[str, ...]] = [
        ("", "size", "p50", "p99", "p99.9", *(("added p50", "p99", "p99.9") if added else ()))
    ]
    for each in points:
        run = each.gentle
        figures = (run.p50, run.p99, run.p999, *(each.added if added else ()))
        rows.append((_way(each, points), byte_count(each.size), *(f"{figure:.2f}" for figure in figures)))
    yield from _aligned(rows)


def _latencies_by_rate(points: Sequence[Point]) -> Iterator[str]:
    yield "Latency at higher rates, ms"
    rows: list[tuple[str, ...]] = [("", "size", "msg/s", "p50", "p99", "p99.9")]
    for each in points:
        for run in each.paced:
            latencies = (f"{figure:.2f}" for figure in (run.p50, run.p99, run.p999))
            rows.append((_way(each, points), byte_count(each.size), f"{run.rate:,.0f}", *latencies))
    yield from _aligned(rows)


def _sides(report: BenchReport) -> Iterator[str]:
    started = any(side.first is not None for sides in report.sides.values() for side in sides)
    if started:
        yield "Each bridge: s until it listens, and until the first message is through; % of a core while idle; memory"
    else:
        yield "Each bridge: % of a core while the benchmark sends nothing; memory"
    rows: list[tuple[str, ...]] = [("", "", *(("listens", "first") if started else ()), "idle", "memory")]
    for transport, sides in report.sides.items():
        for name, side in zip(("sends", "receives"), sides, strict=True):
            starts = (_NONE if each is None else f"{each:.2f}" for each in (side.listening, side.first))
            idle = _NONE if side.idle is None else f"{side.idle:.2f} %"
            rows.append((transport, name, *(starts if started else ()), idle, f"{side.memory:.0f} MB"))
    yield from _aligned(rows)


def _many(report: BenchReport) -> Iterator[str]:
    yield "Topics at 1 Hz each: s until all carry messages; memory (MB) and CPU (% of a core), sends / receives"
    rows: list[tuple[str, ...]] = [("topics", "all carry", "memory", "CPU")]
    for each in report.many:
        memory, cpu = each.memory, each.cpu
        rows.append((str(each.count), f"{each.opened:.1f}", *(f"{a:.0f} / {b:.0f}" for a, b in (memory, cpu))))
    yield from _aligned(rows)


def _way(point: Point, points: Sequence[Point]) -> str:
    two_ways = len({each.direction for each in points}) > 1
    return f"{point.transport} {point.direction}" if two_ways else point.transport


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Align the first column to the left, the others to the right."""
    columns = max(map(len, rows))
    widths = [max(len(row[at]) for row in rows if at < len(row)) for at in range(columns)]
    for row in rows:
        first, *others = row
        cells = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=False)]
        yield "  ".join([f"{first:<{widths[0]}}", *cells]).rstrip()


def capacity(points: Iterable[Point], size: float) -> float:
    """Return the highest rate (Hz) for messages of a size, between and beyond the sizes that were measured.

    Between two measured sizes it is interpolated linearly, by logarithms. A message below the smallest size costs as
    much as that one; a message above the largest costs as much for each byte.

    Args:
        points: points of one transport and direction.
    """
    near = _nearest(points, size)
    if not near:
        return 0.0
    (low, many), *_, (high, few) = ((each.size, each.best.rate if each.best else 0.0) for each in (near[0], near[-1]))
    if len(near) == 1:
        return many if size <= low else many * low / size
    if low == high or not (many and few):
        return few
    share = math.log(size / low) / math.log(high / low)
    return math.exp(math.log(many) + share * math.log(few / many))


def _nearest(points: Iterable[Point], size: float) -> list[Point]:
    """Return the measured points next to a size: the ones below and above it, or the outermost one."""
    known = sorted((each for each in points if each.best or _lost(each)), key=lambda each: each.size)
    below = [each for each in known if each.size <= size]
    above = [each for each in known if each.size >= size]
    return below[-1:] + above[:1]


def _open_ended(points: Iterable[Point], size: float) -> bool:
    """Whether the link may carry more messages of a size than were tried."""
    return any(each.limit in ("time", "leave") for each in _nearest(points, size))


def _lost(point: Point) -> bool:
    """Whether even the lowest rate was too high. If only the time ran out, this is unknown."""
    return point.best is None and point.limit == "loss"


def judge(loads: Iterable[Load], points: Sequence[Point]) -> list[Judged]:
    """Judge each topic alone: by its own transport, otherwise by the best measured one."""
    return [judged for load in loads if (judged := _judge(load, points)) is not None]


def _judge(load: Load, points: Sequence[Point]) -> Judged | None:
    ways = {(each.transport, each.direction) for each in points if each.best or _lost(each)}
    own = [way for way in ways if way[0] == load.transport] or sorted(ways)
    own = [way for way in own if way[1] == load.direction] or own
    if not own:
        return None
    by_way = {way: [each for each in points if (each.transport, each.direction) == way] for way in own}
    most = {way: capacity(its, load.size) for way, its in by_way.items()}
    way = max(own, key=lambda each: most[each])
    # JSON has no infinity.
    share = min(load.rate / most[way], 1e9) if most[way] else 1e9
    at_most = _open_ended(by_way[way], load.size)
    return Judged(load, way[0], share, _verdict(share, at_most=at_most), at_most)


def _verdict(share: float, *, at_most: bool) -> Literal["carried", "barely", "not", "unknown"]:
    # Where the search was cut short, the link may carry more than was tried.
    if share <= (1.0 if at_most else BARELY):
        return "carried"
    if at_most:
        return "unknown"
    return "barely" if share <= 1 else "not"


def in_words(judged: Sequence[Judged], over: str, *, together: bool) -> list[str]:
    """Describe the verdict in sentences.

    Args:
        over: words for the measured link: ``this link``.
        together: whether all topics run at the same time.
    """
    if not judged:
        return ["No verdict: no topic has a rate and a size yet, or too little was measured."]
    by = {
        verdict: [_load(each) for each in judged if each.verdict == verdict]
        for verdict in ("carried", "barely", "not", "unknown")
    }
    lines = []
    if by["carried"]:
        others = f", not {join_first(by['not'], _NAMED)}" if by["not"] else ""
        lines.append(f"{over} carries {join_first(by['carried'], _NAMED)}{others}.")
    elif by["not"]:
        lines.append(JudgingText.CARRIES_NONE(over=over, others=join_first(by["not"], _NAMED)))
    if by["barely"]:
        lines.append(f"Just enough for {join_first(by['barely'], _NAMED)}; any further load costs messages.")
    if by["unknown"]:
        lines.append(JudgingText.UNKNOWN(over=over, topics=join_first(by["unknown"], _NAMED)))
    total = sum(each.share for each in judged)
    # Shares that are upper bounds only do not add up to a verdict.
    if together and len(judged) > 1 and not by["not"] and total > BARELY and not any(each.at_most for each in judged):
        taken = f"{100 * total:.0f} % of it, {'more than' if total > 1 else 'nearly all'} its capacity"
        lines.append(f"Together they take {taken}: limit the largest (max_rate).")
    return [line[0].upper() + line[1:] for line in lines]


def _load(judged: Judged) -> str:
    load = judged.load
    return f"{load.topic} ({byte_count(round(load.size))} at {expected(load.rate)} Hz by {judged.transport})"


class CapacityCurve(NamedTuple):
    """One transport and direction: bytes, and bytes a second that are carried without a loss."""

    name: str
    points: tuple[tuple[float, float], ...]


def _curves(points: Sequence[Point]) -> list[CapacityCurve]:
    two_ways = len({each.direction for each in points}) > 1
    found: dict[str, list[tuple[float, float]]] = {}
    for each in points:
        if each.best is not None:
            name = f"{each.transport} {each.direction}" if two_ways else each.transport
            found.setdefault(name, []).append((each.size, each.best.rate * each.size))
    return [CapacityCurve(name, tuple(sorted(values))) for name, values in found.items()]


class _Axis:
    """An axis that maps a value to its share of the way between the ends."""

    def __init__(self, values: Sequence[float]) -> None:
        self.low = math.floor(math.log10(min(values)))
        # An axis has one power of ten at least: with a single value, its length would be 0, and `at` divides by it.
        self.high = max(math.ceil(math.log10(max(values))), self.low + 1)

    def at(self, value: float) -> float:
        return (math.log10(value) - self.low) / (self.high - self.low)

    @property
    def ticks(self) -> list[float]:
        return [10.0**power for power in range(self.low, self.high + 1)]


def _axes(lines: Sequence[CapacityCurve]) -> tuple[_Axis, _Axis]:
    return tuple(_Axis([point[at] for line in lines for point in line.points]) for at in (0, 1))  # type: ignore[return-value]


def in_terminal(points: Sequence[Point], width: int) -> list[str]:
    """Draw the points in lines of plain characters, at most `width` wide."""
    lines = _curves(points)
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
    """Draw the points as an SVG document, or a note if there are no points."""
    lines = _curves(points)
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
