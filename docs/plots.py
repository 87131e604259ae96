"""Draws the picture of docs/beside.md from figures of `bench.robot` and `bench.outages`: ``make plots``.

The bars are medians of the rounds, from p50 to p99. A time line is one run.
"""

from __future__ import annotations

import json
import math
from html import escape
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs/figures"
PICTURE = FIGURES / "beside.svg"
TOPIC = "/joint_states"
_NAMES = {"zenoh-bridge": "zenoh-bridge-ros2dds", "tcp": "rsb-console, TCP", "udp": "rsb-console, UDP"}
_NAMES |= {"zenoh": "rsb-console, Zenoh", "bbr": "BBR"}
_OURS, _OTHER, _LATE, _LOST = "#1f6fb2", "#8a5a00", "#e08a00", "#c62828"
_WIDE, _LEFT, _RIGHT = 800, 270, 110
_ROW, _HEAD, _FOOT = 26, 58, 34
_SHORTEST, _LONGEST = 30.0, 10_000.0  # ms
_BEFORE, _AFTER = -2.8, 29.0  # s from the cut's begin
_EVERY, _IN_TIME = 0.1, 1.0  # s


def drawn() -> str:
    """Return the picture as SVG."""
    robot: Mapping[str, Any] = json.loads((FIGURES / "wifi.json").read_text(encoding="utf-8"))
    outages: Mapping[str, Any] = json.loads((FIGURES / "cut.json").read_text(encoding="utf-8"))
    columns = robot["wifi"]
    runs = {run["transport"]: run["timelines"] for run in reversed(outages["runs"]) if run["fault"] == "cut-20"}
    lines = {name: runs[name]["reliable"] for name in ("tcp", "udp", "zenoh", "zenoh-bridge")}
    lines |= {f"{name}+keep_all": runs[name]["whole"] for name in ("tcp", "zenoh-bridge")}
    second = _HEAD + len(columns) * _ROW + _FOOT
    high = second + _HEAD + len(lines) * _ROW + _FOOT + 14
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {high}" font-family="sans-serif">',
        f'<rect width="{_WIDE}" height="{high}" fill="white"/>',
        *_latencies(columns),
        f'<g transform="translate(0 {second})">',
        *_time_lines(lines),
        "</g>",
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _latencies(columns: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    def at(milliseconds: float) -> float:
        share = math.log(milliseconds / _SHORTEST) / math.log(_LONGEST / _SHORTEST)
        return _LEFT + min(max(share, 0), 1) * (_WIDE - _LEFT - _RIGHT)

    yield _text(20, 24, "Joint states over a bad Wi-Fi: latency (p50 to p99), and the part that arrives", 15)
    bottom = _HEAD + len(columns) * _ROW
    for tick, words in (
        (30, "30 ms"),
        (100, "100 ms"),
        (300, "300 ms"),
        (1_000, "1 s"),
        (3_000, "3 s"),
        (10_000, "10 s"),
    ):
        yield from _grid(at(tick), bottom, words)
    for number, (name, runs) in enumerate(columns.items()):
        cells = [run["rows"][TOPIC] for run in runs]
        # Where nothing arrived outside of the gaps, the latency is longer than the axis.
        p50, p99 = (median(each[key] or _LONGEST for each in cells) for key in ("p50", "p99"))
        part = median(each["part"] for each in cells)
        y, colour = _HEAD + (number + 0.5) * _ROW, _OTHER if name.startswith("zenoh-bridge") else _OURS
        yield _label(y, name)
        yield _bar(at(p50), y - 6, at(p99) - at(p50), 12, colour, f"{p50:.0f} to {p99:.0f} ms")
        yield f'<circle cx="{at(p50):.1f}" cy="{y:.1f}" r="7" fill="{colour}"/>'
        yield _text(_WIDE - 20, y + 4, f"{part:.0%}".replace("%", " %"), 14, "end", colour)


def _time_lines(lines: Mapping[str, Sequence[tuple[float, float | None]]]) -> Iterator[str]:
    def at(seconds: float) -> float:
        return _LEFT + (seconds - _BEFORE) / (_AFTER - _BEFORE) * (_WIDE - _LEFT - _RIGHT)

    yield _text(
        20, 24, "A link is down for 20 s: messages of a reliable topic of 10 Hz, by when they were published", 15
    )
    bottom = _HEAD + len(lines) * _ROW
    yield _bar(at(0), _HEAD, at(20) - at(0), bottom - _HEAD, "#f1f1f1", "the link is down")
    for tick in (0, 5, 10, 15, 20, 25):
        yield from _grid(at(tick), bottom, f"{tick} s")
    for number, (name, line) in enumerate(lines.items()):
        y = _HEAD + (number + 0.5) * _ROW
        yield _label(y, name)
        shown = [(made, _colour(made, heard)) for made, heard in line if _BEFORE <= made <= _AFTER]
        for colour, alike in groupby(shown, key=itemgetter(1)):
            first, *others = (at(made) for made, _ in alike)
            yield _bar(first, y - 8, (others or [first])[-1] - first + at(_EVERY) - at(0), 16, colour)
        lost = sum(colour == _LOST for _, colour in shown)
        yield _text(_WIDE - 20, y + 4, f"{lost} lost", 14, "end", _LOST if lost else _OURS)
    across = _LEFT
    for colour, words in ((_OURS, "arrives within 1 s"), (_LATE, "arrives later"), (_LOST, "never arrives")):
        yield _bar(across, bottom + _FOOT - 4, 10, 10, colour)
        yield _text(across + 16, bottom + _FOOT + 5, words)
        across += 150


def _colour(made: float, heard: float | None) -> str:
    if heard is None:
        return _LOST
    return _LATE if heard - made > _IN_TIME else _OURS


def _grid(x: float, bottom: float, words: str) -> Iterator[str]:
    yield f'<line x1="{x:.1f}" y1="{_HEAD}" x2="{x:.1f}" y2="{bottom}" stroke="#ddd"/>'
    yield _text(x, _HEAD - 8, words, 12, "middle", "#555")


def _label(y: float, name: str) -> str:
    way, *options = name.split("+")
    return _text(20, y + 4, " + ".join([_NAMES.get(way, way), *(_NAMES.get(each, each) for each in options)]))


def _bar(x: float, y: float, wide: float, high: float, colour: str, title: str = "") -> str:
    shape = f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(wide, 0):.1f}" height="{high:.1f}" fill="{colour}"'
    return f"{shape}><title>{escape(title)}</title></rect>" if title else f"{shape}/>"


def _text(x: float, y: float, words: str, size: int = 12, anchor: str = "start", colour: str = "#222") -> str:
    about = f'font-size="{size}" text-anchor="{anchor}" fill="{colour}"'
    return f'<text x="{x:.1f}" y="{y:.1f}" {about}>{escape(words)}</text>'


if __name__ == "__main__":
    PICTURE.write_text(drawn(), encoding="utf-8")
