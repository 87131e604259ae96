"""Write what a pane lists to a file, for a report or a spreadsheet."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import new_file
from rsb_bridge.model.text import one_line
from rsb_console.session.history import cell, csv_report, text_report

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.history import HistoryReport
    from rsb_bridge.model.snapshot import Event, RouteSnapshot

# The names are those of `status --json`. A topic has what is in a `Ledger`, all else what is in a `CallsSnapshot`.
_ROUTE = (
    "topic", "link", "outgoing", "transport", "port", "type_name", "rate", "expected_rate", "bytes_per_second",
    "latency_p50", "latency_p99", "age", "cause", "reason",
)  # fmt: skip
_COUNTS = (
    "offered", "delivered", "throttled", "expired", "in_flight", "dropped_total", "unknown", "lost_in_dds",
    "missed_while_down",
    "asked", "answered", "refused", "lost", "late", "node_p50", "node_p99", "way_p50", "way_p99", "last_failure",
)  # fmt: skip


def _new_file(kind: str, suffix: str) -> Path:
    return Path.cwd() / f"rsb-{kind}-{time.strftime('%Y%m%d-%H%M%S')}.{suffix}"


def export_log(events: Sequence[Event]) -> Path:
    """Write `events`, oldest first, one a line with its full time.

    Returns:
        The file, in the working folder.
    """
    path = _new_file("log", "txt")
    with new_file(path) as file:
        for event in events:
            stamp = time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(event.time))
            line = f"{stamp} {event.level} {event.source} {event.link or '-'} {event.text}"
            file.write(f"{one_line(line)}\n")
    return path


def export_topics(routes: Sequence[RouteSnapshot]) -> Path:
    """Write `routes` with their figures (Hz, bytes/s, s) and counts as CSV. What one has no figure of is left empty.

    Returns:
        The file, in the working folder.
    """
    path = _new_file("topics", "csv")
    with new_file(path, newline="") as file:
        table = csv.writer(file)
        table.writerow(("state", "kind", *_ROUTE, *_COUNTS))
        for route in routes:
            figures = [getattr(route, name) for name in _ROUTE]
            table.writerow([cell(each) for each in (route.state, route.spec.kind, *figures, *_counts(route))])
    return path


def _counts(route: RouteSnapshot) -> Iterator[object]:
    counts = route.ledger if route.calls is None else route.calls
    for name in _COUNTS:
        value = getattr(counts, name, None)
        yield sum(value.values()) if isinstance(value, dict) else value


def export_history(report: HistoryReport) -> tuple[Path, Path]:
    """Write what happened as text and as CSV.

    Returns:
        Both files, in the working folder.
    """
    text, table = _new_file("history", "txt"), _new_file("history", "csv")
    with new_file(text) as file:
        file.writelines(f"{one_line(line)}\n" for line in text_report(report))
    with new_file(table, newline="") as file:
        file.write(csv_report(report))
    return text, table
