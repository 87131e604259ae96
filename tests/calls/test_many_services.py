"""Services by the hundred, and their lasting."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.calls.ledgers import balanced, called, nothing_left
from tests.support.bridge import now
from tests.support.waiting import eventually, holds

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode

    from rsb_bridge.engine import Engine

_NODES, _EACH = 10, 20
_FORGOTTEN_AFTER = 15.0


@pytest.mark.long
def test_two_hundred_services_of_ten_nodes_are_there_at_once_and_stay(
    bridge: Bridge, near: CallNode, far: CallNode, service: str
) -> None:
    """In zenoh-plugin-ros2dds #326, services discovered together were forgotten ten seconds later."""
    names = [f"{service}_{node}_{number}" for node in range(_NODES) for number in range(_EACH)]
    for node in range(_NODES):
        far.serve(*(name for name in names if name.startswith(f"{service}_{node}_")), node=f"server{node}")
    engines = server, client = bridge.both(*(called(name) for name in names))
    with balanced(*engines):
        near.waits_for(*names)
        _call(near, names, 5)
        holds(lambda: near.ready(*names), _FORGOTTEN_AFTER)
        _call(near, names, 1)
        for engine in (client, server):
            eventually(lambda engine=engine: _all_answered(engine, 6), what="both sides count all of them")
    nothing_left(*engines)


def _call(near: CallNode, names: list[str], count: int) -> None:
    for name in names:
        near.begin(name, count, at_once=count)
    outcomes = {name: near.settled(name) for name in names}
    assert [name for name, outcome in outcomes.items() if not outcome.right] == []


def _all_answered(engine: Engine, count: int) -> bool:
    calls = [route.calls for route in now(engine).routes]
    return all(each is not None and each.asked == each.answered == count for each in calls)
