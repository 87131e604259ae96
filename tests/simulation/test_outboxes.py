"""Queues of a link that carries next to nothing."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.simulation.beds import until
from tests.support.inside import waiting_frames

if TYPE_CHECKING:
    from tests.simulation.call_harness import CallHarness


@pytest.mark.parametrize("provider", ["server", "client"])
@pytest.mark.bed(timeout=2.0)
async def test_nothing_waits_of_calls_that_have_expired(provider: str, harness: CallHarness) -> None:
    """Neither a request on the callers' side nor an answer on the other one, whose places in the budgets are free."""
    server, client = harness.server(waits=True), harness.client()
    await harness.ready(client)
    random = harness.world.random("requests")
    for _ in range(30):
        client.ask(random.randbytes(20_000))
    await until(lambda: len(server.asked) == 30, 1.5)
    near, far = harness.halves()
    with harness.world.trouble("narrow", harness.robot):
        for path in harness.world.network.both_ways(harness.near.machine, harness.far.machine):
            path.bandwidth = 20_000.0
        server.answer()
        for _ in range(100):
            client.ask(random.randbytes(20_000))
        await asyncio.sleep(1.0)
        assert waiting_frames(near)
        assert waiting_frames(far)

        def over() -> bool:
            server.answer()  # the requests that were on their way when the link got narrow
            return [calls.in_flight for calls in harness.counted()] == [0, 0]

        await until(over, 15.0)
        assert not waiting_frames(near)
        assert not waiting_frames(far)
        assert "did not answer" not in far.flow.calls.last_failure, "the node did, and the link is at fault"
