"""How a link that carries less than is asked for is divided among its topics. It uses no clock and changes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

FLOOR = 0.05
"""Part of the link that each lower priority keeps together, whatever those above it want."""

K = TypeVar("K", bound="Hashable")


class Wish(NamedTuple):
    """What one topic wants.

    Attributes:
        rank: of its priority; the higher one comes first.
        bytes_per_second: on the wire.
    """

    rank: int
    bytes_per_second: float


def allot(capacity: float, wishes: Mapping[K, Wish]) -> dict[K, float]:
    """Divide a link: the highest priority first, each of the lower ones keeping at least `FLOOR`.

    Topics of one priority share equally (max-min fairness): who wants less than an equal share gets it all.

    Args:
        capacity: bytes/s.
        wishes: of each topic.

    Returns:
        Bytes/s by topic, at most what it wants.
    """
    ranks = sorted({wish.rank for wish in wishes.values()}, reverse=True)
    floors = {rank: min(_sum(wishes, rank), FLOOR * capacity) for rank in ranks}
    left = max(0.0, capacity)
    shares: dict[K, float] = {}
    for at, rank in enumerate(ranks):
        kept = sum(floors[lower] for lower in ranks[at + 1 :])
        its = {key: wish.bytes_per_second for key, wish in wishes.items() if wish.rank == rank}
        given = fair_shares(max(0.0, left - kept), its)
        shares |= given
        left -= sum(given.values())
    return shares


def fair_shares(capacity: float, wanted: Mapping[K, float]) -> dict[K, float]:
    """Divide bytes/s equally among those who want more than their part, after those who want less."""
    shares: dict[K, float] = {}
    left = capacity
    for count, (key, each) in enumerate(sorted(wanted.items(), key=_amount)):
        shares[key] = min(each, left / (len(wanted) - count))
        left -= shares[key]
    return shares


def _amount(item: tuple[object, float]) -> float:
    return item[1]


def _sum(wishes: Mapping[K, Wish], rank: int) -> float:
    return sum(wish.bytes_per_second for wish in wishes.values() if wish.rank == rank)


def highest(ranks: Sequence[int]) -> int:
    """The rank that comes first; 0 where there is none."""
    return max(ranks, default=0)
