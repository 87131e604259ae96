"""An operator of the server who asks a robot for things by ticket, while links are cut and bridges killed."""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Protocol

from rsb_bridge.link.extension import LinkError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.simulation.world import World

    from rsb_bridge.link.link import Link

_SETTLED = 60.0
"""s after which a request that was lost begins no more, even on a bad network."""


class Answer(Protocol):
    """The end of what was asked for."""

    @property
    def refused(self) -> bool: ...
    @property
    def reason(self) -> str: ...


class Asking:
    """Asks for one thing after the other, and judges what ran of it.

    Attributes:
        armed: whether something is armed that forbids it.
        answers: how many requests ended so.
    """

    def __init__(self, world: World, ask: Callable[[Link], Coroutine[None, None, Answer]], most: int) -> None:
        """Prepare it.

        Args:
            most: runs of one process in a minute.
        """
        self._world, self._ask, self._most = world, ask, most
        self._random = world.random("asking")
        self._ran = 0
        self._by_process: dict[int, list[float]] = defaultdict(list)
        self.armed = False
        self.answers: Counter[str] = Counter()

    async def run(self, process: object) -> None:
        """Carry it out, in place of a command or a node."""
        now = self._world.loop.time()
        if self.armed:
            self._world.wrong("it ran while something was armed")
        times = self._by_process[id(process)]
        times.append(now)
        if sum(now - each < 60.0 for each in times) > self._most:
            self._world.wrong(f"it ran more than {self._most} times in a minute")
        self._ran += 1
        await asyncio.sleep(self._random.choice((0.0, self._random.uniform(0.0, 4.0))))

    async def live(self, requests: int) -> None:
        """Ask so often, and have each request judged once it cannot run any more."""
        while sum(self.answers.values()) < requests:
            await asyncio.sleep(self._random.expovariate(0.2))
            self.armed = self._random.random() < 0.1
            ends = self._world.link_ends(self._world.robots[0])
            server = self._world.server.run
            if ends is None or server is None:
                continue
            before = self._ran
            answer = await server.command(self._answer(ends[1]), who="anna")
            if answer is None:
                self.answers["lost"] += 1
                await asyncio.sleep(_SETTLED)
                self._judge("was lost", self._ran - before, {0, 1})
            elif answer.refused:
                self.answers[f"refused: {answer.reason}"] += 1
                self._judge(f"was refused ({answer.reason})", self._ran - before, {0})
            else:
                self.answers["ran"] += 1
                self._judge("has ended", self._ran - before, {1})
        # The end of the world would tear a fault that stops a bridge.
        while self._world.robots[0].troubles:  # noqa: ASYNC110 -- plain state of a simulated world
            await asyncio.sleep(1.0)

    async def _answer(self, link: Link) -> Answer | None:
        """Return the answer to a request, or None if the link was lost before it came."""
        try:
            return await self._ask(link)
        except LinkError:
            return None

    def _judge(self, what: str, runs: int, right: set[int]) -> None:
        if runs not in right:
            self._world.wrong(f"a request that {what} ran {runs} times")
