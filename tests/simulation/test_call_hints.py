"""What the sides say of a service that nobody serves where its entry says so."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.simulation.booths import SETTLED, Booth
from tests.simulation.test_calls import lived

from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.simulation.conftest import Play


@pytest.mark.parametrize("provider", ["server", "client"])
def test_a_node_on_the_callers_side_may_be_the_one_that_is_meant(provider: str, play: Play) -> None:
    booth = Booth(1, provider)
    meant = {"server": "provider: client", "client": "provider: server"}[provider]

    async def live() -> None:
        assert not any(meant in shown.reason for shown in booth.shown())
        wrong = booth.teller("/here", far=False)
        await asyncio.sleep(SETTLED + 1.0)
        for shown in booth.shown():
            assert shown.cause == Cause.NO_SERVER
            assert meant in shown.reason
            assert "/here" in shown.reason
        wrong.server.close()
        await asyncio.sleep(SETTLED + 1.0)
        assert not any(meant in shown.reason for shown in booth.shown())
        booth.teller()
        await asyncio.sleep(SETTLED + 1.0)
        assert booth.offered

    lived(play, booth, live())


def test_a_similar_name_is_proposed_only_where_nobody_ever_served(play: Play) -> None:
    booth = Booth()
    booth.far_name = f"{booth.far_name}s"

    async def live() -> None:
        alike = booth.teller()
        await asyncio.sleep(SETTLED + 10.0)
        assert all(f"did you mean {booth.far_name}?" in shown.reason for shown in booth.shown())
        booth.far_name = booth.far_name[:-1]
        right = booth.teller()
        await asyncio.sleep(SETTLED)
        right.server.close()
        await asyncio.sleep(SETTLED + 10.0)
        assert [shown.cause for shown in booth.shown()] == [Cause.SERVER_GONE] * 2
        assert not any("did you mean" in shown.reason for shown in booth.shown())
        alike.server.close()

    lived(play, booth, live())
