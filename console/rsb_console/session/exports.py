"""The files that panes are exported to, and cells and times in such files."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import new_file
from rsb_bridge.model.text import one_line
from rsb_console.notation.formats import PatternRow, Row

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.snapshot import Event

_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
"""What a cell begins with that a spreadsheet may take for a formula; the last four are the signs in full width."""
# The names are as in `status --json`. A topic has the fields of `Ledger`, other kinds of `CallsSnapshot`.
_ROUTE = (
    "topic", "link", "outgoing", "transport", "port", "type_name", "rate", "expected_rate", "bytes_per_second",
    "latency_p50", "latency_p99", "age", "cause", "reason",
)  # fmt: skip
_COUNTS = (
    "offered", "delivered", "throttled", "expired", "waiting", "in_flight", "dropped_total", "unknown", "lost_in_dds",
    "missed_while_down", "unsubscribed", "again",
    "asked", "answered", "refused", "lost", "late", "node_p50", "node_p99", "way_p50", "way_p99", "last_failure",
)  # fmt: skip


def cell(value: object) -> object:
    """Escape a value for a spreadsheet: no formula in foreign text, and no control characters."""
    if not isinstance(value, str):
        return value
    text = one_line(value)
    return f"'{text}" if text.startswith(_FORMULAS) else text


def full_time(moment: float) -> str:
    """Format a moment, in s since the epoch, with its zone."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(moment))


def export_path(kind: str, suffix: str) -> Path:
    """Return the path of a new file, in the working folder."""
    return Path.cwd() / f"rsb-{kind}-{time.strftime('%Y%m%d-%H%M%S')}.{suffix}"


def export_log(events: Sequence[Event]) -> Path:
    """Write `events`, oldest first, one a line with its full time.

    Returns:
        The file, in the working folder.
    """
    path = export_path("log", "txt")
    with new_file(path) as file:
        for event in events:
            line = f"{full_time(event.time)} {event.level} {event.source} {event.link or '-'} {event.text}"
            file.write(f"{one_line(line)}\n")
    return path


def export_topics(rows: Sequence[Row]) -> Path:
    """Write `rows` with their figures (Hz, bytes/s, s) and counts as CSV. What one has no figure of is left empty.

    Returns:
        The file, in the working folder.
    """
    path = export_path("topics", "csv")
    with new_file(path, newline="") as file:
        table = csv.writer(file)
        table.writerow(("state", "kind", *_ROUTE, *_COUNTS))
        for row in rows:
            figures = [getattr(row, name, None) for name in _ROUTE]
            table.writerow([cell(each) for each in (row.state, row.spec.kind, *figures, *_counts(row))])
    return path


def _counts(row: Row) -> Iterator[object]:
    counts = None if isinstance(row, PatternRow) else row.calls or row.ledger
    for name in _COUNTS:
        value = getattr(counts, name, None)
        yield sum(value.values()) if isinstance(value, dict) else value
