"""Invariants of calls. For topics and links, see `tests.simulation.invariants`."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from tests.simulation.action_invariants import left_of_ended_calls, near_and_far, offered
from tests.support.inside import pending_calls

from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.wire.headers import CALL_HEADER_LENGTH

if TYPE_CHECKING:
    from tests.simulation.engine_host import Run
    from tests.simulation.service_flow import ServiceFlow
    from tests.simulation.world import Robot, World

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.peer_budget import PeerBudget

WITHDRAWN_WITHIN = 1.5
"""s from when a link is down until a service is offered no more: the second that it may take, and one look at it."""
OFFERED_WITHIN = 15.0
"""s from when nothing keeps a service from being called until it can be."""
ANSWERED_WITHIN = 5.0
"""s from when nothing keeps a call from being answered."""


class CallInvariants:
    def __init__(self, world: World) -> None:
        self._world = world
        self._patience = world.conditions.patience
        self._can_call: dict[ServiceFlow, float] = {}
        self._given_up: dict[ServiceFlow, int] = {}

    def check(self) -> None:
        for run in self._world.runs():
            self._check_counts(run)
        for service in self._world.service_flows.values():
            self._check_service(service)

    def _check_counts(self, run: Run) -> None:
        """Check that the counts of calls add up, and that the budgets hold exactly the calls in flight."""
        for link in run.links():
            under_way: Counter[bool] = Counter()
            for route in link.routes.values():
                if isinstance(half := route.half, Caller | Provider):
                    calls, held = half.flow.calls, len(pending_calls(half))
                    if calls.in_flight != held:
                        self._world.wrong(
                            f"{run.host.name}: {route.key} counts {calls.in_flight} calls in flight, and has "
                            f"{held}: {calls.snapshot()}"
                        )
                    if left := left_of_ended_calls(half):
                        self._world.wrong(f"{run.host.name}: of calls that are over, {route.key} has {left}")
                    if held and not link.linked and link.suspended_since is None:
                        self._world.wrong(f"{run.host.name}: {route.key} has {held} calls in flight without a link")
                    under_way[isinstance(half, Caller)] += held
            self._check_budget(run, link.budget, under_way)

    def _check_budget(self, run: Run, budget: PeerBudget, under_way: Counter[bool]) -> None:
        for what, asks in ((budget.asked, True), (budget.provided, False)):
            calls, size = what.held
            if calls != under_way[asks] or size < calls * CALL_HEADER_LENGTH or (size and not calls):
                self._world.wrong(
                    f"{run.host.name}: {under_way[asks]} calls are in flight, and {calls} with {size} bytes held"
                )

    def _check_service(self, service: ServiceFlow) -> None:
        world, now = self._world, self._world.loop.time()
        robot = world.robot(service.robot)
        near, far = near_and_far(world, service)
        link = _link(near, robot) if near is not None else None
        is_gone = link is None or not (link.linked or link.suspended_since is not None)
        if near is not None and is_gone and offered(near, service):
            world.wrong(f"{service}: it is offered, and the link is down")
        if near is not None and service.server is None and not service.dead_is_seen and offered(near, service):
            gone = now - service.changed if link is None else now - max(service.changed, link.linked_at)
            if gone > self._patience * WITHDRAWN_WITHIN and link is not None and link.linked and not robot.troubles:
                world.wrong(f"{service}: it is offered, though the server has been gone for {gone:.1f} s")
        if near is None or far is None or link is None or not self._can_be_called(robot, service):
            self._can_call.pop(service, None)
            return
        self._check_answers(robot, near, service)

    def _check_answers(self, robot: Robot, near: Run, service: ServiceFlow) -> None:
        world, now = self._world, self._world.loop.time()
        began = (self._can_call.setdefault(service, now), service.changed, robot.commanded, world.clear_since(robot))
        waited = now - max(began)
        if waited > self._patience * OFFERED_WITHIN and not offered(near, service):
            world.wrong(f"{service}: it can be called for {waited:.1f} s, and is not offered; {world.said(service)}")
        given_up = sum(_given_up(link, service) for link in world.link_ends(robot) or ())
        if given_up != self._given_up.get(service):
            self._given_up[service] = given_up
            service.forgive()
        elif service.overdue > self._patience * ANSWERED_WITHIN and waited > self._patience * OFFERED_WITHIN:
            world.wrong(f"{service}: a call waits for {service.overdue:.1f} s; {world.said(service)}")

    def _can_be_called(self, robot: Robot, service: ServiceFlow) -> bool:
        ends = self._world.link_ends(robot)
        if ends is None or robot.troubles or service.troubles or not all(link.linked for link in ends):
            return False
        if service.server is None:
            return False
        halves = [half for link in ends if (half := half_of(link, service)) is not None]
        return len(halves) == len(ends) and not any(half.route.pausing.paused for half in halves)


def half_of(link: Link, service: ServiceFlow) -> Caller | Provider | None:
    for route in link.routes.values():
        if isinstance(route.half, Caller | Provider) and route.topic == service.near_name:
            return route.half
    return None


def _link(run: Run, robot: Robot) -> Link | None:
    return next((link for link in run.links() if link.name == robot.name), None)


def _given_up(link: Link, service: ServiceFlow) -> int:
    half = half_of(link, service)
    if half is None:
        return -1
    calls = half.flow.calls
    return calls.lost + calls.expired + calls.refused.total()
