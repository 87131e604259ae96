"""Both sides' hints for a service that has no server on the side that its entry names."""

from __future__ import annotations

import asyncio

import pytest
from tests.simulation.call_harness import SETTLED, CallHarness

from rsb_bridge.model.verdict import Cause


@pytest.mark.parametrize("provider", ["server", "client"])
async def test_node_on_callers_side_may_be_meant(provider: str, harness: CallHarness) -> None:
    meant = {"server": "provider: client", "client": "provider: server"}[provider]
    assert not any(meant in shown.reason for shown in harness.shown())
    wrong = harness.server("/here", far=False)
    await asyncio.sleep(SETTLED + 1.0)
    for shown in harness.shown():
        assert shown.cause == Cause.NO_SERVER
        assert meant in shown.reason
        assert "/here" in shown.reason
    wrong.endpoint.close()
    await asyncio.sleep(SETTLED + 1.0)
    assert not any(meant in shown.reason for shown in harness.shown())
    harness.server()
    await asyncio.sleep(SETTLED + 1.0)
    assert harness.offered


async def test_similar_name_is_proposed_unless_served_before(harness: CallHarness) -> None:
    harness.far_name = f"{harness.far_name}s"
    alike = harness.server()
    await asyncio.sleep(SETTLED + 10.0)
    assert all(f"did you mean {harness.far_name}?" in shown.reason for shown in harness.shown())
    harness.far_name = harness.far_name[:-1]
    right = harness.server()
    await asyncio.sleep(SETTLED)
    right.endpoint.close()
    await asyncio.sleep(SETTLED + 10.0)
    assert [shown.cause for shown in harness.shown()] == [Cause.SERVER_GONE] * 2
    assert not any("did you mean" in shown.reason for shown in harness.shown())
    alike.endpoint.close()
