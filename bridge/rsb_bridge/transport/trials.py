"""Tries of announced addresses, of which anybody in a network may announce any number.

Each address is tried by a handshake, many at once, until one has proven a key. Addresses that have not are remembered,
and tried less and less often.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Coroutine, Iterable

T = TypeVar("T")

AT_ONCE = 128
"""Addresses whose tries begin at once. One costs about 0.5 ms, so a third of each `_WAVE` is left for other work."""
MOST_TRIED = 1024
"""Addresses of one search: 8 waves."""
_WAVE = 0.1
"""s between two times that `AT_ONCE` tries begin: a round figure."""
_OTHERS = 0.3
"""s that others have once one has proven the key, so that a second one shows: a round figure."""
_FIRST_PAUSE, _LONGEST_PAUSE = 2.0, 60.0
"""s until an address that has failed is tried again, at first and at most: round figures."""
_FEW = 8
"""Addresses that are always tried, however often they have failed: a round figure."""


class UnprovenError(Exception):
    """An address did not prove the key; the arguments say why."""


class Results(NamedTuple, Generic[T]):
    """The outcome of a search.

    Attributes:
        proven: results of the addresses that proved the key, by address.
        failures: reasons of the addresses that answered without a proof.
        others: announced addresses that have not proven the key, whether they were tried or not.
    """

    proven: dict[str, T]
    failures: list[UnprovenError]
    others: int


class Trials(Generic[T]):
    """Searches among announced addresses; remembers what did not prove the key, for as long as it is announced.

    Args:
        patience: s that the last addresses of a search have: a handshake over a slow network.
    """

    def __init__(self, now: Callable[[], float], patience: float = 5.0) -> None:
        self._now = now
        self._patience = patience
        self._failed: dict[str, tuple[int, float]] = {}  # number of failures, and the time of the next attempt
        self._proven: set[str] = set()

    async def search(
        self,
        announced: Collection[str],
        attempt: Callable[[str], Coroutine[None, None, T]],
        discard: Callable[[T], None],
    ) -> Results[T]:
        """Try addresses until one or more have proven the key, or none can.

        Args:
            announced: all that there are.
            attempt: tries one; raises `UnprovenError`.
            discard: takes what an attempt returned that comes too late.
        """
        self._forget(announced)
        queue = self._due(announced)
        running: dict[asyncio.Task[T], str] = {}
        results = Results[T]({}, [], 0)
        try:
            await self._try_all(queue, attempt, running, results)
        except BaseException:
            for each in results.proven.values():
                discard(each)
            raise
        finally:
            for task, address in running.items():
                if task.cancel():
                    self._fail(address)
            # One may have succeeded before it was cancelled, and holds a connection.
            for left in await asyncio.gather(*running, return_exceptions=True):
                if not isinstance(left, BaseException):
                    discard(left)
        return results._replace(others=len(set(announced) - results.proven.keys()))

    async def _try_all(
        self,
        queue: list[str],
        attempt: Callable[[str], Coroutine[None, None, T]],
        running: dict[asyncio.Task[T], str],
        results: Results[T],
    ) -> None:
        now = next_wave = self._now()
        ends = now + self._patience
        while (queue or running) and now < ends:
            if queue and now >= next_wave:
                running |= {asyncio.create_task(attempt(each)): each for each in queue[:AT_ONCE]}
                queue, next_wave, ends = queue[AT_ONCE:], now + _WAVE, now + self._patience
            until = next_wave if queue else ends
            done: set[asyncio.Task[T]] = set()
            if running:
                done, _ = await asyncio.wait(running, timeout=until - now, return_when=asyncio.FIRST_COMPLETED)
            else:
                await asyncio.sleep(until - now)
            for task in done:
                self._note_result(task, running.pop(task), results)
            now = self._now()
            if results.proven and done:
                queue, ends = [], min(ends, now + _OTHERS)

    def _note_result(self, task: asyncio.Task[T], address: str, results: Results[T]) -> None:
        try:
            results.proven[address] = task.result()
        except UnprovenError as error:
            results.failures.append(error)
            self._fail(address)
        else:
            self._failed.pop(address, None)
            self._proven.add(address)

    def _fail(self, address: str) -> None:
        count = self._failed.get(address, (0, 0.0))[0] + 1
        # A float cannot hold 2.0 ** 1024, and an address may fail for days.
        pause = min(_FIRST_PAUSE * 2.0 ** min(count - 1, 10), _LONGEST_PAUSE)
        self._failed[address] = count, self._now() + pause
        self._proven.discard(address)

    def _forget(self, announced: Collection[str]) -> None:
        """Forget the addresses that are not announced any more: so the memory has the bound of announcements."""
        present = set(announced)
        self._proven &= present
        self._failed = {each: failed for each, failed in self._failed.items() if each in present}

    def _due(self, announced: Iterable[str]) -> list[str]:
        """Return the addresses to try: earlier proofs of the key first, then the fewest failures."""
        now, nothing = self._now(), (0, 0.0)
        ordered = sorted(announced, key=lambda each: (each not in self._proven, self._failed.get(each, nothing)))
        due = [each for each in ordered if self._failed.get(each, nothing)[1] <= now]
        return ordered[:_FEW] if len(due) < _FEW else due[:MOST_TRIED]
