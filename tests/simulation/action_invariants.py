"""Invariants of actions, besides the invariants of all calls (`tests.simulation.call_invariants`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.held import held_by
from tests.support.inside import numbers_of, pending_calls, timer_of, waiting_frames

from rsb_bridge.route.calls.action_goals import CallerGoals, ProviderGoals
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider

if TYPE_CHECKING:
    from tests.simulation.action_flow import ActionFlow
    from tests.simulation.engine_host import Run
    from tests.simulation.goals import Goal
    from tests.simulation.service_flow import ServiceFlow
    from tests.simulation.world import World

    from rsb_bridge.link.link import Link

REACHED_WITHIN = 15.0
"""s from when nothing keeps an action from being reached until its clients see it."""
WITHDRAWN_WITHIN = 45.0
"""s until a server that was killed is seen no more, and is offered no more."""
TOLD_WITHIN = 10.0
"""s from then, or from an event, until everybody who waits for it knows."""


class ActionInvariants:
    def __init__(self, world: World) -> None:
        self._world = world
        self._patience = world.conditions.patience
        self._can_be_reached: dict[ActionFlow, float] = {}

    def check(self) -> None:
        for action in self._world.action_flows.values():
            self._check_action(action)

    def _check_action(self, action: ActionFlow) -> None:
        world, now = self._world, self._world.loop.time()
        robot = world.robot(action.robot)
        ends = world.link_ends(robot)
        halves = halves_of(world, action)
        near, _ = near_and_far(world, action)
        dead_is_seen = action.dead_is_seen
        gone = action.server is None and not dead_is_seen
        if near is not None and offered(near, action):
            if not any(
                link.linked or link.suspended_since is not None for link in near.links() if link.name == robot.name
            ):
                world.wrong(f"{action}: clients see a server, and the link is down")
            waited = now - max(action.changed, world.clear_since(robot))
            if gone and waited > self._patience * WITHDRAWN_WITHIN and not robot.troubles:
                world.wrong(f"{action}: clients see a server, and it has been gone for {waited:.1f} s")
        if (
            ends is None or robot.troubles or action.troubles or action.server is None or dead_is_seen
            or len(halves) < len(ends)
            or not all(link.linked for link in ends) or any(half.route.pausing.paused for half in halves)
        ):  # fmt: skip
            self._can_be_reached.pop(action, None)
            return
        since = self._can_be_reached.setdefault(action, now)
        clear = max(since, action.changed, robot.commanded, world.clear_since(robot)) + self._patience * REACHED_WITHIN
        if now > clear:
            assert near is not None
            self._check_reached(action, near, clear)

    def _check_reached(self, action: ActionFlow, near: Run, clear: float) -> None:
        world, now, server = self._world, self._world.loop.time(), action.server
        assert server is not None
        if not offered(near, action):
            world.wrong(f"{action}: it can be reached, and is not offered; {said(world, action)}")
        soon = self._patience * TOLD_WITHIN
        for goal in action.waiting():
            asked = goal.asks
            if asked is None or asked.at is None:
                waited = now - max(clear, goal.sent)
            else:
                waited = now - max(clear, asked.at, goal.ended)
            if waited > soon and not server.runs(goal.id):
                world.wrong(f"{action}: {goal} waits for its result for {waited:.1f} s; {said(world, action)}")
        for goal in action.to_cancel():
            assert goal.cancel is not None
            waited = now - max(clear, goal.cancel.at or 0.0)
            if waited > soon:
                world.wrong(f"{action}: {goal} is to be cancelled for {waited:.1f} s; {said(world, action)}")
        waited = now - max(clear, server.said_at)
        if waited > soon and server.said and action.heard != server.said:
            world.wrong(f"{action}: clients hear another status than the server's; {said(world, action)}")

    def explains(self, action: ActionFlow, goal: Goal) -> bool:
        """Whether what happened explains that nobody knows the result of a goal."""
        world = self._world
        _, far = near_and_far(world, action)
        if goal.server is not action.server or far is None or far.began > goal.sent:
            return True  # the process that knew it was restarted
        if action.server is not None and action.server.remembers(goal.id):
            return False
        ended = max((half.route.opened_at for half in halves_of(world, action)), default=goal.sent)
        return max(world.robot(action.robot).commanded, action.changed, ended) > goal.sent


def near_and_far(world: World, flow: ActionFlow | ServiceFlow) -> tuple[Run | None, Run | None]:
    """The engines on the clients' and on the server's side."""
    ends = world.robot(flow.robot).host.run, world.server.run
    return ends if flow.topic.direction == "transmit" else ends[::-1]


def halves_of(world: World, action: ActionFlow) -> list[Caller | Provider]:
    links: list[Link] = list(world.link_ends(world.robot(action.robot)) or ())
    found = [route.half for link in links for route in link.routes.values() if route.topic == action.near_name]
    return [half for half in found if isinstance(half, Caller | Provider) and half.route.proposal.kind == "action"]


def said(world: World, action: ActionFlow) -> str:
    shown = [half.route.snapshot() for half in halves_of(world, action)]
    return "; ".join(f"{each.state} {each.reason!r} {each.calls} {each.goals}" for each in shown)


def offered(run: Run, flow: ActionFlow | ServiceFlow) -> bool:
    servers, node = run.host.domain.services.servers, f"/{run.node.node_name}"
    return any(each.node == node for each in servers[flow.near_services[0]])


def left_of_ended_calls(half: Caller | Provider) -> list[str]:
    """Return tables of a half that still hold ended calls."""
    calls = pending_calls(half)
    found = [
        f"{frame.what.name} {frame.call} in the outbox"
        for frame in waiting_frames(half)
        if frame.call and frame.what.name != "REFUSED" and frame.call not in calls
    ]
    if isinstance(half, Provider):
        found += [f"number {number}" for number, call in numbers_of(half).items() if call not in calls]
    if not len(calls) and timer_of(calls) is not None and not held_by(calls):
        found.append("a timer")
    return found


def left_at_rest(half: Caller | Provider) -> list[str]:
    """Return tables of a half that are not empty although no goal runs and no request can be repeated any more."""
    found = left_of_ended_calls(half)
    tables: dict[str, object] = {
        "calls in flight": half.flow.calls.in_flight,
        "calls under way": len(pending_calls(half)),
        "frames": len(waiting_frames(half)),
    }
    if isinstance(half.kind, CallerGoals | ProviderGoals):
        tables |= {"running goals": len(half.kind.goals.running())}
    budget = half.route.peer.budget
    tables |= {"held of the budget": max((budget.asked if isinstance(half, Caller) else budget.provided).held)}
    return found + [f"{length} {what}" for what, length in tables.items() if length]
