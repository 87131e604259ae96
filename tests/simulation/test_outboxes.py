"""What waits to be sent over a link that carries next to nothing."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.simulation.booths import Booth
from tests.simulation.test_calls import lived, until

if TYPE_CHECKING:
    from tests.simulation.conftest import Play


@pytest.mark.parametrize("provider", ["server", "client"])
def test_nothing_waits_of_calls_that_have_expired(provider: str, play: Play) -> None:
    """Neither a request on the callers' side nor an answer on the other one, whose places in the budgets are free."""
    booth = Booth(1, provider, timeout=2.0)

    async def live() -> None:
        teller, asker = booth.teller(waits=True), booth.asker()
        await booth.ready(asker)
        random = booth.world.random("requests")
        for _ in range(30):
            asker.ask(random.randbytes(20_000))
        await until(lambda: len(teller.asked) == 30, 1.5)
        near, far = booth.halves()
        with booth.world.trouble("narrow", booth.robot):
            for path in booth.world.network.both_ways(booth.near.machine, booth.far.machine):
                path.bandwidth = 20_000.0
            teller.answer()
            for _ in range(100):
                asker.ask(random.randbytes(20_000))
            await asyncio.sleep(1.0)
            assert near._outbox._frames
            assert far._outbox._frames
            await asyncio.sleep(1.5)
            assert [calls.in_flight for calls in booth.counted()] == [0, 0]
            assert not near._outbox._frames
            assert not far._outbox._frames
            assert "did not answer" not in far.calls.last_failure, "the node did, and the link is at fault"

    lived(play, booth, live())
