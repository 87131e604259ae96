"""Which topics a link carries, judged by what was measured; and that in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rsb_bridge.model.text import join_first
from rsb_console.bench.results import Judged, Load
from rsb_console.look.formats import byte_count, expected

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Literal

    from rsb_console.bench.results import Point

BARELY = 0.8
"""The share of the highest lossless rate from which on a topic has too little to spare."""
USUAL = (
    Load("an IMU", 320, 200),
    Load("a laser scan", 9_000, 40),
    Load("a map", 400_000, 1),
    Load("a compressed camera image", 150_000, 30),
    Load("a depth image of 640 × 480", 614_400, 30),
    Load("a point cloud", 1_200_000, 10),
    Load("a raw camera image of 1920 × 1080", 6_220_800, 30),
)
"""What robots usually send; for a benchmark that knows of no session."""
_NAMED = 8


def capacity(points: Iterable[Point], size: float) -> float:
    """The highest rate (Hz) for messages of a size, between and beyond the sizes that were measured.

    Between two sizes it is on a straight line of logarithms. Smaller messages than the smallest that was measured are
    taken for as dear as that, larger ones than the largest for as dear by the byte.

    Args:
        points: of one transport and direction.
        size: bytes.
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
    """The points that say what is carried of a size: the ones below and above it, or the one at its end."""
    known = sorted((each for each in points if each.best or _lost(each)), key=lambda each: each.size)
    below = [each for each in known if each.size <= size]
    above = [each for each in known if each.size >= size]
    return below[-1:] + above[:1]


def _open_ended(points: Iterable[Point], size: float) -> bool:
    """Whether more may be carried of a size than was tried."""
    return any(each.limit in ("time", "leave") for each in _nearest(points, size))


def _lost(point: Point) -> bool:
    """Whether even the lowest rate was too high. Where only the time was up, nothing is known."""
    return point.best is None and point.limit == "loss"


def judge(loads: Iterable[Load], points: Sequence[Point]) -> list[Judged]:
    """Whether each topic alone is carried: by its own transport, else by the best that was measured."""
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
    share = min(load.rate / most[way], 1e9) if most[way] else 1e9
    at_most = _open_ended(by_way[way], load.size)
    return Judged(load, way[0], share, _verdict(share, at_most=at_most), at_most)


def _verdict(share: float, *, at_most: bool) -> Literal["carried", "barely", "not", "unknown"]:
    if share <= (1.0 if at_most else BARELY):
        return "carried"
    if at_most:
        return "unknown"
    return "barely" if share <= 1 else "not"


def in_words(judged: Sequence[Judged], over: str, *, together: bool) -> list[str]:
    """The verdict, in sentences.

    Args:
        judged: the topics.
        over: what was measured: ``this link``.
        together: whether all of them are there at the same time.
    """
    if not judged:
        return ["Nothing to judge: no topic has a rate and a size yet, or too little was measured."]
    by = {
        verdict: [_load(each) for each in judged if each.verdict == verdict]
        for verdict in ("carried", "barely", "not", "unknown")
    }
    lines = []
    if by["carried"]:
        rest = f", not {join_first(by['not'], _NAMED)}" if by["not"] else ""
        lines.append(f"{over} carries {join_first(by['carried'], _NAMED)}{rest}.")
    elif by["not"]:
        lines.append(f"{over} does not carry {join_first(by['not'], _NAMED)}.")
    if by["barely"]:
        lines.append(f"Only just: {join_first(by['barely'], _NAMED)}; anything else there costs messages.")
    if by["unknown"]:
        lines.append(f"Too little was tried to say whether {over} carries {join_first(by['unknown'], _NAMED)}.")
    total = sum(each.share for each in judged)
    if together and len(judged) > 1 and not by["not"] and total > BARELY and not any(each.at_most for each in judged):
        much = "more than there is" if total > 1 else "nearly all there is"
        lines.append(f"Together they take {100 * total:.0f} % of it, {much}: limit the largest (max_rate).")
    return [line[0].upper() + line[1:] for line in lines]


def _load(judged: Judged) -> str:
    load = judged.load
    return f"{load.topic} ({byte_count(round(load.size))} at {expected(load.rate)} Hz by {judged.transport})"
