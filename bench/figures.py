"""Figures of several beds by round, and their ratios and differences within a round."""

from __future__ import annotations

from collections import defaultdict
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class Spread(NamedTuple):
    """A figure of several rounds."""

    middle: float
    low: float
    high: float


class Figures:
    """Values by round, of each bed and each quantity. A bed that lost messages has no value in that round."""

    def __init__(self) -> None:
        self._values: defaultdict[tuple[str, str], dict[int, float]] = defaultdict(dict)

    def add(self, number: int, bed: str, quantity: str, value: float) -> None:
        self._values[bed, quantity][number] = value

    def names(self, bed: str, start: str) -> list[str]:
        """Return the rest of the names of a bed's quantities that begin so."""
        return [name.removeprefix(start) for of, name in self._values if of == bed and name.startswith(start)]

    def latest(self, bed: str, quantity: str) -> float | None:
        """Return the value of the last round that has one, or None."""
        values = self._values[bed, quantity]
        return values[max(values)] if values else None

    def spread(self, bed: str, quantity: str) -> Spread | None:
        """Return the median of all rounds with the lowest and the highest, or None without a value."""
        return _spread([*self._values[bed, quantity].values()])

    def ratio(self, bed: str, quantity: str, other: str) -> Spread | None:
        """Return a bed's value by another's, from the rounds in which both have one."""
        return self._paired(bed, quantity, other, lambda a, b: a / b if b else None)

    def added(self, bed: str, quantity: str, other: str) -> Spread | None:
        """Return the value that a bed has more than another, from the rounds in which both have one."""
        return self._paired(bed, quantity, other, lambda a, b: a - b)

    def _paired(
        self, bed: str, quantity: str, other: str, combine: Callable[[float, float], float | None]
    ) -> Spread | None:
        mine, theirs = self._values[bed, quantity], self._values[other, quantity]
        combined = [combine(mine[number], theirs[number]) for number in sorted(mine.keys() & theirs.keys())]
        return _spread([each for each in combined if each is not None])


def _spread(values: Sequence[float]) -> Spread | None:
    return Spread(median(values), min(values), max(values)) if values else None


def in_turn(beds: Sequence[str], turn: int) -> list[str]:
    """Return the beds in the order of a turn. Each is first in its turn, so that none always has the same place."""
    first = turn % len(beds)
    return [*beds[first:], *beds[:first]]


def print_table(
    title: str,
    rows: Sequence[str],
    columns: Sequence[str],
    cell: Callable[[str, str], Spread | None],
    digits: int,
    of: str = "",
) -> None:
    """Print medians with the lowest and the highest for the rows that have a figure, and a dash for a missing one.

    Args:
        rows: loads or quantities.
        columns: beds.
        cell: returns the figure of a bed and a quantity.
        digits: digits after the point.
        of: the quantity, if rows are loads.
    """
    cells = {row: [cell(column, f"{row} {of}".strip()) for column in columns] for row in rows}
    cells = {row: its for row, its in cells.items() if any(its)}
    if not cells:
        return
    print(f"\n{title}: median (lowest to highest)")
    print(f"{'':>20}", *(f"{column:>22}" for column in columns))
    for row, its in cells.items():
        print(f"{row:>20}", *(f"{_text(each, digits):>22}" for each in its), flush=True)


def _text(spread: Spread | None, digits: int) -> str:
    if spread is None:
        return "-"
    middle, low, high = (f"{each:,.{digits}f}" for each in spread)
    return middle if low == high else f"{middle} ({low} to {high})"
