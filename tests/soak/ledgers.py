"""The ledgers that a process prints: each must balance at every moment; their sums over all processes' lives."""

from __future__ import annotations

from collections import Counter
from typing import Any, TypeAlias

Row: TypeAlias = "dict[str, Any]"
"""A route in a line of ``status`` (docs/headless.md)."""
Key: TypeAlias = "tuple[str, str, bool]"
"""Link, topic, and whether this side sends."""

_PARTS = ("delivered", "throttled", "expired", "unknown", "waiting", "in_flight")
_MOST_MISTAKES = 20


class Book:
    def __init__(self, process: str) -> None:
        self.newest: dict[Key, Row] = {}
        self.checked = 0
        self.wrong: list[str] = []
        self._process = process
        self._before: Counter[str] = Counter()

    def take(self, rows: list[Row]) -> None:
        """Check the rows of a status line, and keep them."""
        for row in rows:
            key = (row["link"], row["topic"], row["outgoing"])
            self.checked += 1
            problem = mistake(row)
            if problem and len(self.wrong) < _MOST_MISTAKES:
                self.wrong.append(f"{self._process}: {row['topic']}: {problem}")
            last = self.newest.get(key)
            if last is not None and row["offered"] < last["offered"]:
                self._before.update(parts(last))  # a new route
            self.newest[key] = row

    def totals(self) -> Counter[str]:
        """The sums of what this process sent, by the ledger's parts."""
        sums = Counter(self._before)
        for (_, _, outgoing), row in self.newest.items():
            if outgoing:
                sums.update(parts(row))
        return sums


def parts(row: Row) -> Counter[str]:
    """Return a ledger's counts, and its drops by cause."""
    counts: Counter[str] = Counter({name: row[name] for name in ("offered", "lost_in_dds", *_PARTS)})
    counts.update({f"dropped: {cause}": count for cause, count in row["dropped"].items()})
    return counts


def mistake(row: Row) -> str:
    """Return a ledger's error in words, or an empty string if it balances."""
    counts = parts(row)
    if negative := [name for name, count in counts.items() if count < 0]:
        return f"negative: {', '.join(negative)} in {dict(counts)}"
    accounted = sum(row[name] for name in _PARTS) + sum(row["dropped"].values())
    return "" if accounted == row["offered"] else f"{row['offered']} offered, {accounted} accounted for: {dict(counts)}"
