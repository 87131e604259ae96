"""What must hold of calls all along: `tests.simulation.invariants` has the same of topics and links."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from tests.simulation.action_invariants import in_flight, left_of_ended_calls

from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.calls_route import CallsRoute
from rsb_bridge.wire.headers import CALL_HEADER_LENGTH

if TYPE_CHECKING:
    from tests.simulation.exchanges import Exchange
    from tests.simulation.station import Run
    from tests.simulation.world import Robot, World

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.peer import PeerBudget

WITHDRAWN_WITHIN = 1.5
"""s from when a link is down until a service is offered no more: the second that it may take, and one look at it."""
OFFERED_WITHIN = 15.0
"""s from when nothing keeps a service from being called until it can be."""
ANSWERED_WITHIN = 5.0
"""s from when nothing keeps a call from being answered."""


class CallInvariants:
    """Watches a world's services."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._patience = world.climate.patience
        self._can_call: dict[Exchange, float] = {}
        self._given_up: dict[Exchange, int] = {}

    def check(self) -> None:
        """Check everything once."""
        for run in self._world.runs():
            self._check_counts(run)
        for exchange in self._world.exchanges.values():
            self._check_exchange(exchange)

    def _check_counts(self, run: Run) -> None:
        """What became of calls adds up, and what they hold of the budgets is what is under way."""
        for link in run.links():
            under_way: Counter[bool] = Counter()
            for route in link.routes.values():
                if isinstance(route, CallsRoute):
                    calls, held = route.calls, len(route._pending)  # type: ignore[attr-defined]
                    if calls.in_flight != in_flight(route):
                        self._world.wrong(
                            f"{run.station.name}: {route.key} counts {calls.in_flight} calls in flight, and has "
                            f"{in_flight(route)}: {calls.snapshot()}"
                        )
                    if left := left_of_ended_calls(route):
                        self._world.wrong(f"{run.station.name}: of calls that are over, {route.key} has {left}")
                    if held and not link.linked:
                        self._world.wrong(f"{run.station.name}: {route.key} has {held} calls under way without a link")
                    under_way[isinstance(route, CallingRoute)] += held
            self._check_budget(run, link.budget, under_way)

    def _check_budget(self, run: Run, budget: PeerBudget, under_way: Counter[bool]) -> None:
        for what, asks in ((budget.asked, True), (budget.provided, False)):
            calls, size = what.held
            if calls != under_way[asks] or size < calls * CALL_HEADER_LENGTH or (size and not calls):
                self._world.wrong(
                    f"{run.station.name}: {under_way[asks]} calls are under way, and {calls} with {size} bytes held"
                )

    def _check_exchange(self, exchange: Exchange) -> None:
        world, now = self._world, self._world.loop.time()
        robot = world.robot(exchange.robot)
        near, far = _runs(world, robot, exchange)
        link = _link(near, robot) if near is not None else None
        if near is not None and (link is None or not link.linked) and _offered(near, exchange):
            world.wrong(f"{exchange}: it is offered, and the link is down")
        if near is not None and exchange.server is None and not exchange.dead and _offered(near, exchange):
            gone = now - exchange.changed
            if gone > self._patience * WITHDRAWN_WITHIN and link is not None and not robot.troubles:
                world.wrong(f"{exchange}: it is offered, though the server has been gone for {gone:.1f} s")
        if near is None or far is None or link is None or not self._can_be_called(robot, exchange):
            self._can_call.pop(exchange, None)
            return
        self._check_answers(robot, near, exchange)

    def _check_answers(self, robot: Robot, near: Run, exchange: Exchange) -> None:
        world, now = self._world, self._world.loop.time()
        began = (self._can_call.setdefault(exchange, now), exchange.changed, robot.commanded, world.clear_since(robot))
        waited = now - max(began)
        if waited > self._patience * OFFERED_WITHIN and not _offered(near, exchange):
            world.wrong(f"{exchange}: it can be called for {waited:.1f} s, and is not offered; {world.said(exchange)}")
        given_up = sum(_given_up(link, exchange) for link in world.link_ends(robot) or ())
        if given_up != self._given_up.get(exchange):
            self._given_up[exchange] = given_up
            exchange.forgive()
        elif exchange.overdue > self._patience * ANSWERED_WITHIN and waited > self._patience * OFFERED_WITHIN:
            world.wrong(f"{exchange}: a call waits for {exchange.overdue:.1f} s; {world.said(exchange)}")

    def _can_be_called(self, robot: Robot, exchange: Exchange) -> bool:
        ends = self._world.link_ends(robot)
        if ends is None or robot.troubles or exchange.troubles or not all(link.linked for link in ends):
            return False
        if exchange.server is None:
            return False
        halves = [half for link in ends if (half := half_of(link, exchange)) is not None]
        return len(halves) == len(ends) and not any(half.paused for half in halves)


def half_of(link: Link, exchange: Exchange) -> CallsRoute | None:
    """A link's half of an exchange's route."""
    for route in link.routes.values():
        if isinstance(route, CallsRoute) and route.topic == exchange.near_name:
            return route
    return None


def _runs(world: World, robot: Robot, exchange: Exchange) -> tuple[Run | None, Run | None]:
    """The engines on the callers' and on the providing side."""
    ends = robot.station.run, world.server.run
    return ends if exchange.topic.direction == "transmit" else ends[::-1]


def _link(run: Run, robot: Robot) -> Link | None:
    return next((link for link in run.links() if link.name == robot.name), None)


def _offered(run: Run, exchange: Exchange) -> bool:
    node = f"/{run.node.node_name}"
    return any(each.node == node for each in run.station.domain.services.servers[exchange.near_name])


def _given_up(link: Link, exchange: Exchange) -> int:
    half = half_of(link, exchange)
    if half is None:
        return -1
    return half.calls.lost + half.calls.expired + half.calls.refused.total()
