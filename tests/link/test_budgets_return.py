"""A link's routes return their parts of its budgets, however they come and go."""

from __future__ import annotations

from collections import Counter
from random import Random
from typing import TYPE_CHECKING, Any

import pytest
from tests.link.route_table_helpers import Side
from tests.route.unpacking_helpers import OnePublisher, grown

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.wire.messages import Close, Describe, Propose
from rsb_bridge.wire.records import Source

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

ROUTES = 400
VOLATILE, LATCHED = Qos(), Qos(durability="transient_local", depth=3)


class Ignores:
    """The peer, which hears nothing."""

    inbox: list[Any]

    def __init__(self) -> None:
        self.inbox = []


def held(side: Side) -> dict[str, int]:
    budget = side.budget
    return {
        "unfinished": budget.unfinished.held,
        "kept": budget.kept.held,
        "unacknowledged": budget.unacknowledged.held,
        "further publishers": budget.further_publishers.held,
        "types": budget.types.used,
        "routes": len(side.routes),
        "open": len(side.ids.open_routes()),
        "demands": len(side.context.demands.read().sources),
    }


@pytest.mark.parametrize("seed", range(2))
def test_after_many_routes_every_count_is_zero(
    seed: int, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    random, ros = Random(seed), OnePublisher()
    side = Side(make_context(ros=ros, role="server"), is_client=False)
    side.other = Ignores()  # type: ignore[assignment]
    nothing, most = held(side), Counter[str]()
    for number in range(1, 2 * ROUTES, 2):
        name = f"/topic{random.randrange(40)}"
        side.table.handle(
            Propose(route=number, topic=f"{name}{random.choice('ab')}", remote_topic=name, from_client=True)
        )
        for _ in range(random.randrange(3)):
            sources = tuple(Source((f"node{each}",)) for each in range(random.randint(1, 4)))
            kind = f"made_up_msgs/msg/Type{random.randrange(400)}", "RIHS01_" + "0" * 64
            side.table.handle(Describe(number, *kind, random.choice((VOLATILE, LATCHED)), sources))
        route = side.ids.open_route(number)
        if route is not None and isinstance(route.half, Receiver):
            ros.published.acknowledged = random.random() < 0.5
            route.deliver([(bytes(random.randrange(100_000)), 0, 0), grown(1_000_000), grown(1_000_000)])
        most |= Counter(held(side))
        ending = random.randrange(5)
        if ending < 3:
            side.table.handle(Close(number, "enough", EndCode.REMOVED if ending else EndCode.DECIDED))
        elif ending == 3 and random.random() < 0.05:
            side.table.disconnected()
            side.ids.take_of_peer(number)
        side.inbox.clear()
        loop.jump(0.01)
        assert all(count >= 0 for count in held(side).values())
    assert all(most[name] for name in ("kept", "unacknowledged", "further publishers", "types")), most
    for route in tuple(side.routes.values()):
        side.table.remove(route, "by an operator")
    assert held(side) == nothing
    assert not loop.errors
