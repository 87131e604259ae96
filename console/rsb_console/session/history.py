"""What happened in a span of time, in words and as tables: for the time line, for `report`, and for files."""

from __future__ import annotations

import csv
import io
import json
import re
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.model.history import KEPT_FOR
from rsb_bridge.model.text import plural

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rsb_bridge.model.history import HistoryReport, Outage, Track
    from rsb_bridge.model.snapshot import Event

CSV_COLUMNS = (
    "kind", "start", "end", "seconds", "robot", "topic", "direction", "state", "cause", "who", "old", "new",
)  # fmt: skip
_UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d)")
_WORST_TOPICS = 10


def parse_span(text: str) -> float:
    """A span of time as people write it: ``8h``, ``30m``, ``90s``.

    Returns:
        s.

    Raises:
        ValueError: it is none, or longer than what is remembered.
    """
    found = _SPAN.fullmatch(text.strip())
    seconds = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not seconds:
        raise ValueError(f"{text!r} is not a time like 8h, 30m or 90s")
    if seconds > KEPT_FOR:
        raise ValueError(f"{text}: at most 24h are remembered")
    return seconds


def length(seconds: float) -> str:
    """A duration in the two largest units: ``12 s``, ``3 min 40 s``, ``7 h 52 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if whole or not seconds else "under 1 s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s" if whole % 60 else f"{whole // 60} min"
    minutes = whole // 60
    return f"{minutes // 60} h {minutes % 60} min" if minutes % 60 else f"{minutes // 60} h"


def percent(ratio: float | None) -> str:
    """A part of the time. It is 100 % only if nothing is missing."""
    if ratio is None:
        return "not known"
    if ratio >= 1:
        return "100 %"
    return f"{min(99.9, ratio * 100):.1f} %"


def own(outages: Iterable[Outage]) -> list[Outage]:
    """Those that do not just come and go with their link's."""
    return [outage for outage in outages if not outage.with_link]


def followers(report: HistoryReport, outage: Outage) -> int:
    """How many topics were out because their link was, in one of a link's outages."""
    if outage.topic:
        return 0
    end = outage.start + outage.seconds
    return len(
        {
            (each.topic, each.outgoing)
            for each in report.outages
            if each.with_link and each.link == outage.link and outage.start <= each.start <= end + 1
        }
    )


def what(outage: Outage) -> str:
    """What was out: ``→ /scan``, or ``link``."""
    return f"{'→' if outage.outgoing else '←'} {outage.topic}" if outage.topic else "link"


def how_long(outage: Outage) -> str:
    """How long it was out, and what is not known of that."""
    if outage.ongoing:
        return f"{length(outage.seconds)}, still so"
    if outage.cut_off:
        return f"at least {length(outage.seconds)}" if outage.seconds >= 1 else "not known how long"
    return length(outage.seconds)


def why(report: HistoryReport, outage: Outage) -> str:
    """The cause, and what else was out for it."""
    count = followers(report, outage)
    also = f" ({count} {plural(count, 'topic')} with it)" if count else ""
    return f"{outage.cause or 'no cause known'}{also}"


def did(event: Event) -> str:
    """What an operator did, with the old and the new value."""
    return event.text + (f" ({event.old or 'nothing'} → {event.new or 'nothing'})" if event.old or event.new else "")


# --- as text


def text_report(report: HistoryReport) -> Iterator[str]:
    """Lines for the shift's hand-over: totals first, then outages by robot and topic, then what operators did."""
    yield f"{report.name} ({report.role}): the last {length(report.span)}, {_from_to(report)}"
    yield from _totals(report)
    yield ""
    outages = own(report.outages)
    yield "Outages" if outages else "No outages."
    for link in sorted({outage.link for outage in outages}):
        yield f"  {link}"
        of_link = [outage for outage in outages if outage.link == link]
        for name, found in _by_topic(of_link):
            yield f"    {name}"
            for outage in found:
                state = outage.state.upper()
                yield f"      {_day_time(outage.start)}  {state}  {how_long(outage)}: {why(report, outage)}"
    if report.outages_left_out:
        yield f"  At least {report.outages_left_out:,} more, for which there was no room."
    if report.actions:
        yield ""
        yield "Operators, and the bridge itself"
        for event in report.actions:
            who = f"{event.who}: " if event.who not in event.text else ""
            yield f"  {_day_time(event.time)}  {who}{did(event)}"
    if report.actions_left_out:
        yield f"  {report.actions_left_out:,} more before these."


def totals(report: HistoryReport) -> list[str]:
    """How much of the time everything was up, in a few sentences."""
    return list(_totals(report))


def _totals(report: HistoryReport) -> Iterator[str]:
    yield _ran(report)
    links = [track for track in report.tracks if not track.topic]
    topics = [track for track in report.tracks if track.topic]
    for track in links:
        yield f"{track.link}: {_up('linked', track)}{_count(track)}."
    if topics:
        bad = [track for track in topics if track.outages]
        fine = len(topics) - len(bad)
        topics_are = f"{len(topics)} {plural(len(topics), 'topic')}"
        yield f"{topics_are}: {fine} without an outage{f', {len(bad)} with' if bad else ''}."
        worst = sorted(bad, key=lambda track: -track.out)
        for track in worst[:_WORST_TOPICS]:
            name = f"{track.link} {'→' if track.outgoing else '←'} {track.topic}"
            yield f"  {name}: {_up('up', track)}{_count(track)}."
        if len(worst) > _WORST_TOPICS:
            yield f"  and {len(worst) - _WORST_TOPICS} more."


def _ran(report: HistoryReport) -> str:
    running = "" if report.running else " It does not run now."
    if not report.gaps:
        return f"The bridge ran all the time.{running}"
    gaps = ", ".join(f"{_day_time(gap.start)} to {_day_time(gap.start + gap.seconds)}" for gap in report.gaps[-3:])
    more = f" and {len(report.gaps) - 3} more times before" if len(report.gaps) > 3 else ""
    return (
        f"The bridge ran for {length(report.watched)} of it ({percent(report.watched / report.span)}); "
        f"nothing is known of {gaps}{more}.{running}"
    )


def _up(word: str, track: Track) -> str:
    if track.up_ratio is None:
        return f"not known how long it was {word}"
    return f"{word} {percent(track.up_ratio)} of the time"


def _count(track: Track) -> str:
    if not track.outages:
        return ""
    return f"; {track.outages} {plural(track.outages, 'outage')}, {length(track.out)} in all"


def _by_topic(outages: Sequence[Outage]) -> list[tuple[str, list[Outage]]]:
    """By topic, the link itself first."""
    grouped: dict[tuple[str, bool], list[Outage]] = {}
    for outage in outages:
        grouped.setdefault((outage.topic, outage.outgoing), []).append(outage)
    return [(what(grouped[key][0]), grouped[key]) for key in sorted(grouped)]


def _from_to(report: HistoryReport) -> str:
    return f"{_day_time(report.start)} to {_day_time(report.time)}"


def _day_time(moment: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(moment))


# --- for programs


def json_report(report: HistoryReport) -> str:
    """All of it as one object."""
    tracks = [{**asdict(track), "up_ratio": track.up_ratio} for track in report.tracks]
    return json.dumps({**asdict(report), "start": report.start, "tracks": tracks}, ensure_ascii=False)


def csv_report(report: HistoryReport) -> str:
    """Outages, gaps, and what operators did, a row each, by time; for a spreadsheet."""
    rows: list[tuple[float, list[object]]] = []
    for outage in report.outages:
        direction = ("out" if outage.outgoing else "in") if outage.topic else ""
        row = ["outage", outage.start, outage.start + outage.seconds, outage.seconds, outage.link, outage.topic]
        rows.append((outage.start, [*row, direction, outage.state, outage.cause, "", "", ""]))
    for gap in report.gaps:
        row = ["not running", gap.start, gap.start + gap.seconds, gap.seconds]
        rows.append((gap.start, [*row, "", "", "", "", "", "", "", ""]))
    for event in report.actions:
        row = ["event", event.time, None, None, event.link, event.topic, "", "", event.text]
        rows.append((event.time, [*row, event.who, event.old, event.new]))
    made = io.StringIO()
    table = csv.writer(made)
    table.writerow(CSV_COLUMNS)
    for _, row in sorted(rows, key=lambda each: each[0]):
        stamps = ["" if moment is None else _iso(moment) for moment in (row[1], row[2])]  # type: ignore[arg-type]
        seconds = "" if row[3] is None else f"{row[3]:.1f}"
        table.writerow([row[0], *stamps, seconds, *map(cell, row[4:])])
    return made.getvalue()


def cell(value: object) -> object:
    """A value for a spreadsheet, which must not take text from elsewhere for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def _iso(moment: float) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(moment))
