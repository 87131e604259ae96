"""What was measured as tables of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.look.formats import byte_count, byte_rate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_console.bench.results import Point, Report

_LIMITS = {
    "loss": "",
    "sender": " (the sender makes no more)",
    "leave": " (no more is allowed)",
    "time": " (time was up)",
}
_NONE = "-"


def lines_of(report: Report) -> Iterator[str]:
    """All tables, each with a line about it."""
    yield f"{report.over}; {report.machine}"
    if report.points:
        yield ""
        yield from _rates(report.points)
        yield ""
        yield from _latencies(report.points)
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
    what = "what the bridge adds to it, next to no bridge" if added else "from this end of the link to the other"
    yield f"Latency at a low rate, ms; {what}"
    rows: list[tuple[str, ...]] = [
        ("", "size", "p50", "p99", "p99.9", *(("added p50", "p99", "p99.9") if added else ()))
    ]
    for each in points:
        run = each.gentle
        figures = (run.p50, run.p99, run.p999, *(each.added if added else ()))
        rows.append((_way(each, points), byte_count(each.size), *(f"{figure:.2f}" for figure in figures)))
    yield from _aligned(rows)


def _sides(report: Report) -> Iterator[str]:
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


def _many(report: Report) -> Iterator[str]:
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
    """The first column to the left, the others to the right."""
    columns = max(map(len, rows))
    widths = [max(len(row[at]) for row in rows if at < len(row)) for at in range(columns)]
    for row in rows:
        first, *others = row
        cells = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=False)]
        yield "  ".join([f"{first:<{widths[0]}}", *cells]).rstrip()
