"""The search for the highest rate at which nothing is lost. No clock: each trial takes as long as it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_console.bench.results import Limit, Run

TRIES = 2
"""At each rate: one loss may be another program's."""
CLOSE = 1.1
"""How close the lowest rate that is too high comes to the highest that is not."""
_KEEPS_UP = 0.95
_LOWEST = 0.5  # Hz


class Found(NamedTuple):
    """What a search found.

    Attributes:
        best: the run at the highest rate without a loss; None: there is none.
        limit: why there is no higher one.
    """

    best: Run | None
    limit: Limit


def highest_lossless(
    trial: Callable[[float], Run],
    *,
    first: float,
    most: float = float("inf"),
    close: float = CLOSE,
    goes_on: Callable[[], bool] = lambda: True,
) -> Found:
    """The run at the highest rate at which nothing was lost.

    Args:
        trial: sends for a while at a rate (Hz).
        first: Hz to begin with.
        most: Hz that may be tried at most.
        close: when the search ends, as `CLOSE`.
        goes_on: asked before each trial but the first; False ends the search with what was found.
    """
    rate, good, bad, tried = min(first, most), None, 0.0, False
    while not (good and bad) or bad > close * good.rate:
        passed = None
        for _ in range(TRIES):
            if tried and not goes_on():
                return Found(good, "time")
            tried = True
            run = trial(rate)
            if run.lossless:
                passed = run
                break
        if passed is None:
            bad = rate
            if rate <= _LOWEST:
                return Found(good, "loss")
        else:
            if good is None or passed.rate > good.rate:
                good = passed
            if passed.rate < _KEEPS_UP * rate:
                return Found(good, "sender")
            if rate >= most:
                return Found(good, "leave")
        rate = min(most, _next(good.rate if good else 0.0, bad))
    return Found(good, "loss")


def _next(good: float, bad: float) -> float:
    if good and bad:
        return (good + bad) / 2
    return good * 2 if good else max(_LOWEST, bad / 2)
