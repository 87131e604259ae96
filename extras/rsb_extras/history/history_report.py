"""Reports of a bridge's history, in words and as tables, and their files."""

from __future__ import annotations

import csv
import io
import json
import re
import time
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.config.files import new_file
from rsb_bridge.feature_api import EventCode, Wording, one_line, plural
from rsb_bridge.model.text import escape_json
from rsb_console.session.exports import cell, export_path, full_time
from rsb_extras.history.history_data import KEPT_FOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Event
    from rsb_extras.history.history_data import HistoryReport, Outage, Track

CSV_COLUMNS = (
    "kind", "start", "end", "seconds", "robot", "topic", "direction", "state", "cause", "who", "old", "new", "is_a",
)  # fmt: skip
_UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d)")
_WORST_TOPICS = 10
"""Topics of a kind that are named; the others are counted. A round figure."""
_KINDS = ("topic", "service", "action", "parameters")
# The texts of these events have their values, which would appear twice.
_SAID_IN_WORDS = (EventCode.OPERATOR_PAUSED, EventCode.OPERATOR_RESUMED, EventCode.OPERATOR_CALL_ENDED)
_SHORT_WAIT = 60.0
"""Seconds of waiting that are too few to mention. A round figure."""


class ReportText(Wording):
    """Sentences of a report on a bridge's last hours."""

    NO_TIME = "{span!r} is not a time like 8h, 30m or 90s"
    TOO_LONG_AGO = "{span}: the history has at most 24h"
    RAN_ALL_THE_TIME = "The bridge ran all the time.{stopped}"
    RAN_PARTLY = "The bridge ran for {watched} of it ({share}); no record of {gaps}{more}.{stopped}"
    STOPPED = " It does not run now."
    NO_OUTAGES = "No outages."
    ACTIONS = "Operators, and the bridge itself"


def parse_span(text: str) -> float:
    """Parse a span of time: ``8h``, ``30m``, ``90s``.

    Returns:
        s.

    Raises:
        ValueError: it is none, or longer than what is remembered.
    """
    found = _SPAN.fullmatch(text.strip())
    seconds = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not seconds:
        raise ValueError(ReportText.NO_TIME(span=text))
    if seconds > KEPT_FOR:
        raise ValueError(ReportText.TOO_LONG_AGO(span=text))
    return seconds


def length(seconds: float) -> str:
    """Format a duration in the two largest units: ``12 s``, ``3 min 40 s``, ``7 h 52 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if whole or not seconds else "under 1 s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s" if whole % 60 else f"{whole // 60} min"
    minutes = whole // 60
    return f"{minutes // 60} h {minutes % 60} min" if minutes % 60 else f"{minutes // 60} h"


def percent(ratio: float | None) -> str:
    """Format a part of the time: 100 % only if nothing is missing, a dash if it was neither up nor out."""
    if ratio is None:
        return "—"
    if ratio >= 1:
        return "100 %"
    return f"{min(99.9, ratio * 100):.1f} %"


def own(outages: Iterable[Outage]) -> list[Outage]:
    """Return the outages that have a cause of their own rather than the link's."""
    return [outage for outage in outages if not outage.with_link]


def followers(report: HistoryReport, outage: Outage) -> str:
    """Count the topics and services that a link's outage took down: ``2 topics, 1 service``; or empty."""
    if outage.topic:
        return ""
    # The recorder looks once a second, so that a topic may follow its link in the next look only.
    end = outage.start + outage.seconds
    out = {
        each.subject
        for each in report.outages
        if each.with_link and each.link == outage.link and outage.start <= each.start <= end + 1
    }
    return ", ".join(_counted(kind, count) for kind, count in _by_kind(kind for _, kind, _, _ in out))


def what(one: Outage | Track) -> str:
    """Name the subject of an outage: ``→ /scan``, ``→ service /load_map``, or ``link``."""
    kind = "" if one.kind == "topic" else f"{one.kind} "
    return f"{'→' if one.outgoing else '←'} {kind}{one.topic}" if one.topic else "link"


def how_long(outage: Outage) -> str:
    """Return the duration of an outage, with the part that has no record."""
    if outage.ongoing:
        return f"{length(outage.seconds)}, still so"
    if outage.cut_off:
        return f"at least {length(outage.seconds)}" if outage.seconds >= 1 else "not known how long"
    return length(outage.seconds)


def why(report: HistoryReport, outage: Outage) -> str:
    """Return the cause of an outage, and the topics and services that it took down."""
    also = followers(report, outage)
    cause = outage.cause or "no cause known"
    return f"{cause} ({also} with it)" if also else cause


def who(event: Event) -> str:
    """Return the operator in a word or two; for one of the other side, with that side's name."""
    if event.from_peer:
        return f"{event.link} says"
    return event.who.partition(" ")[0] or "bridge"


def did(event: Event) -> str:
    """Describe an operator's action with the old and the new value, unless its words include them."""
    if event.code in _SAID_IN_WORDS or not (event.old or event.new):
        return event.text
    if event.old and event.new:
        return f"{event.text} ({event.old} → {event.new})"
    return f"{event.text} ({event.new or f'was {event.old}'})"


# --- as text


def text_report(report: HistoryReport) -> Iterator[str]:
    """Return lines for a hand-over: totals, then outages by robot and topic, then operators' actions."""
    yield f"{report.name} ({report.role}): the last {length(report.span)}, {_from_to(report)}"
    yield from totals(report)
    yield ""
    outages = own(report.outages)
    yield "Outages" if outages else ReportText.NO_OUTAGES()
    for link in sorted({outage.link for outage in outages}):
        yield f"  {link}"
        of_link = [outage for outage in outages if outage.link == link]
        for name, found in _by_topic(of_link):
            yield f"    {name}"
            for outage in found:
                start, state = moment(outage.start, report.time), outage.state.upper()
                yield f"      {start}  {state}  {how_long(outage)}: {why(report, outage)}"
    if report.outages_left_out:
        yield f"  At least {report.outages_left_out:,} more, dropped for lack of room."
    if report.actions:
        yield ""
        yield ReportText.ACTIONS()
        for event in report.actions:
            who = f"{event.who}: " if event.who not in event.text else ""
            yield f"  {moment(event.time, report.time)}  {who}{did(event)}"
    if report.actions_left_out:
        yield f"  {report.actions_left_out:,} more before these."


def totals(report: HistoryReport) -> Iterator[str]:
    """Describe the share of the time in which everything was up, in a few sentences."""
    yield _ran(report)
    links = [track for track in report.tracks if not track.topic]
    for track in links:
        yield f"{track.link}: {_up('linked', track)}{_count(report, track)}."
    for kind, _ in _by_kind(track.kind for track in report.tracks if track.topic):
        yield from _totals_of(report, kind, [track for track in report.tracks if track.topic and track.kind == kind])


def _totals_of(report: HistoryReport, kind: str, tracks: Sequence[Track]) -> Iterator[str]:
    """Yield the sentences about one kind; the worst ones by name."""
    none_yet = f"without any {'message' if kind == 'topic' else 'call'} yet"
    bad = [track for track in tracks if track.outages]
    waited = [track for track in tracks if not track.outages and track.waiting and not track.up]
    parts = [f"{len(tracks) - len(bad) - len(waited)} without an outage"]
    parts += [f"{len(bad)} with"] * bool(bad)
    parts += [f"{len(waited)} {none_yet}"] * bool(waited)
    yield f"{_counted(kind, len(tracks))}: {', '.join(parts)}."
    worst = sorted(bad, key=lambda track: -track.out)
    for track in worst[:_WORST_TOPICS]:
        yield f"  {track.link} {what(track)}: {_up('up', track)}{_count(report, track)}."
    if len(worst) > _WORST_TOPICS:
        yield f"  and {len(worst) - _WORST_TOPICS} more with an outage."
    for track in waited[:_WORST_TOPICS]:
        yield f"  {track.link} {what(track)}: {_up('up', track)}."
    if len(waited) > _WORST_TOPICS:
        yield f"  and {len(waited) - _WORST_TOPICS} more {none_yet}."


def _by_kind(kinds: Iterable[str]) -> list[tuple[str, int]]:
    """Return how many there are of each kind, topics first."""
    counts = Counter(kinds)
    return sorted(counts.items(), key=lambda item: _KINDS.index(item[0]) if item[0] in _KINDS else len(_KINDS))


def _counted(kind: str, count: int) -> str:
    """Format a count: ``3 topics``, ``parameters of 1 node``."""
    return (
        f"parameters of {count} {plural(count, 'node')}" if kind == "parameters" else f"{count} {plural(count, kind)}"
    )


def _ran(report: HistoryReport) -> str:
    stopped = "" if report.running else ReportText.STOPPED()
    if not report.gaps:
        return ReportText.RAN_ALL_THE_TIME(stopped=stopped)
    ends = ((gap.start, gap.start + gap.seconds) for gap in report.gaps[-3:])
    gaps = ", ".join(f"{moment(start, report.time)} to {moment(end, report.time)}" for start, end in ends)
    earlier = len(report.gaps) - 3
    more = f" and {earlier} {plural(earlier, 'earlier time')}" if earlier > 0 else ""
    share = percent(report.watched / report.span if report.span > 0 else 0.0)  # another machine's bridge may say 0 s
    return ReportText.RAN_PARTLY(watched=length(report.watched), share=share, gaps=gaps, more=more, stopped=stopped)


def _up(word: str, track: Track) -> str:
    """Describe the share of the time in which it was up; waiting counts as neither up nor out."""
    up = "" if track.up_ratio is None else f"{word} {percent(track.up_ratio)} of the time"
    if track.waiting < _SHORT_WAIT and (up or not track.waiting):
        return up or f"not known how long it was {word}"
    waited = f"{', ' if up else ''}waited {length(track.waiting)}"
    return f"{up}{waited}{f' ({track.waits_for})' if track.waits_for else ''}"


def _count(report: HistoryReport, track: Track) -> str:
    if not track.outages:
        return ""
    followed = sum(each.with_link and each.subject == track.subject for each in report.outages)
    with_link = f" ({followed} with the link)" if followed else ""
    return f"; {track.outages} {plural(track.outages, 'outage')}{with_link}, {length(track.out)} in all"


def _by_topic(outages: Sequence[Outage]) -> list[tuple[str, list[Outage]]]:
    """Return a sort key: the link itself first, then by topic and kind."""
    grouped: dict[tuple[str, str, bool], list[Outage]] = {}
    for outage in outages:
        grouped.setdefault((outage.topic, outage.kind, outage.outgoing), []).append(outage)
    return [(what(grouped[key][0]), grouped[key]) for key in sorted(grouped)]


def _from_to(report: HistoryReport) -> str:
    start, end = time.localtime(report.start), time.localtime(report.time)
    # A report spans 24 h at most, so that the day of the year tells days apart.
    date = "" if start.tm_yday == end.tm_yday else "%a %Y-%m-%d "
    return f"{time.strftime('%a %Y-%m-%d %H:%M:%S', start)} to {time.strftime(f'{date}%H:%M:%S', end)}"


def moment(at: float, now: float) -> str:
    """Format the time of day, with the day of the week if it is not the day of `now`."""
    then, end = time.localtime(at), time.localtime(now)
    return time.strftime("%H:%M:%S" if then.tm_yday == end.tm_yday else "%a %H:%M:%S", then)


# --- for programs


def json_report(report: HistoryReport, **more: object) -> str:
    """Convert the report to one object, with `more` members."""
    tracks = [{**asdict(track), "up_ratio": track.up_ratio} for track in report.tracks]
    members = {"ok": True, **asdict(report), "start": report.start, "tracks": tracks, **more}
    return escape_json(json.dumps(members, ensure_ascii=False))


def csv_report(report: HistoryReport) -> str:
    """Format outages, gaps and operators' actions as CSV: a row each, by time."""
    rows: list[tuple[float, list[object]]] = []
    for outage in report.outages:
        direction = ("out" if outage.outgoing else "in") if outage.topic else ""
        row = ["outage", outage.start, outage.start + outage.seconds, outage.seconds, outage.link, outage.topic]
        is_a = outage.kind if outage.topic else "link"
        rows.append((outage.start, [*row, direction, outage.state, outage.cause, "", "", "", is_a]))
    for gap in report.gaps:
        row = ["not running", gap.start, gap.start + gap.seconds, gap.seconds]
        rows.append((gap.start, [*row, "", "", "", "", "", "", "", "", ""]))
    for event in report.actions:
        row = ["event", event.time, None, None, event.link, event.topic, "", "", event.text]
        rows.append((event.time, [*row, event.who, event.old, event.new, ""]))
    made = io.StringIO()
    table = csv.writer(made)
    table.writerow(CSV_COLUMNS)
    # Rows are sorted by time alone, since cells of two kinds of rows do not compare.
    for _, row in sorted(rows, key=lambda each: each[0]):
        stamps = ["" if each is None else full_time(each) for each in (row[1], row[2])]  # type: ignore[arg-type]
        seconds = "" if row[3] is None else f"{row[3]:.1f}"
        table.writerow([row[0], *stamps, seconds, *map(cell, row[4:])])
    return made.getvalue()


def export_history(report: HistoryReport) -> tuple[Path, Path]:
    """Write what happened as text and as CSV.

    Returns:
        Both files, in the working folder.
    """
    text, table = export_path("history", "txt"), export_path("history", "csv")
    with new_file(text) as file:
        file.writelines(f"{one_line(line)}\n" for line in text_report(report))
    with new_file(table, newline="") as file:
        file.write(csv_report(report))
    return text, table
