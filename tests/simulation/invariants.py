"""Invariants of links and topics.

Every few seconds, each check compares the engines' state with the flows' counts. It allows
what has an explanation: a robot in trouble may be unlinked, a topic without a publisher may be silent. A state without
an explanation that lasts longer than an engine may take is a violation, and ends the world.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TYPE_CHECKING

from tests.simulation.action_invariants import ActionInvariants
from tests.simulation.call_invariants import CallInvariants
from tests.simulation.tables import tables

from rsb_bridge.channel.data_stream import StreamReceiver
from rsb_bridge.model.fates import Fate, Lost
from rsb_bridge.model.limits import KEPT_DEPTH
from rsb_bridge.model.snapshot import State
from rsb_bridge.route.calls.goals import MOST_GOALS
from rsb_bridge.route.receiver import Receiver

if TYPE_CHECKING:
    from tests.simulation.engine_host import Run
    from tests.simulation.topic_flow import Account, TopicFlow
    from tests.simulation.world import Robot, World

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.sender import Sender

LINKED_WITHIN = 15.0
"""s from the end of what kept a robot from being linked."""
NOTICED_WITHIN = 10.0
"""s from when nothing gets through in one of the two directions until neither side seems to be linked: 5 s of silence
for one side, and as long for the other where only one direction is cut."""
AGREED_WITHIN = 25.0
"""s from then, or from the last command: a route that was refused is tried again after up to 10 s, and one that nobody
asks for any more is forgotten up to 13 s after it was closed."""
FLOWS_WITHIN = 15.0
"""s from when nothing keeps a topic from flowing until its messages come out, and from a message to the other end."""
SETTLED_WITHIN = 6.0
"""s after the last message until both sides have counted it."""
SAME_VERDICT_WITHIN = 8.0
"""s in which one side looks at its half of a route, tells the other what it makes of it, and is heard."""
LATE_WITHIN = 5.0
"""s from when messages come out late until neither side shows their topic as ok."""
_LATE_MESSAGES, _COMES = 3, 2.0
"""Messages in a row that have to be late, and s since the last one: a burst that waited for a reconnect is none."""
_SEEN_WITHIN = 5.0
"""s from when a task fails until somebody must have asked why."""
_SWEEP_EVERY = 600.0
_ITEMS, _ITEMS_EACH = 100, 20
"""In one table: so many, and so many more for each route and each link."""
_BOUNDED = {
    ".goals._goals": MOST_GOALS,
    ".undecided": MOST_GOALS,
    ".sinks[]._waiting": KEPT_DEPTH,
    ".sinks[]._free": KEPT_DEPTH,
    "._outbox.queue.waiting": KEPT_DEPTH,
}
"""Tables that are kept for people, or for an hour, or that have a message or a number for each that DDS or a link takes
later."""
_TASKS, _DESCRIPTORS, _TIMERS = 10, 10, 20
"""Of one engine: so many, and four more for each route and each link."""


class Invariants:
    """Watches a world.

    Attributes:
        worst_recovery: s, the longest that a robot took to be linked once it could be.
    """

    def __init__(self, world: World) -> None:
        self.checks = 0
        self.worst_recovery = 0.0
        self._world = world
        self._patience = world.conditions.patience
        self._random = world.random("invariants")
        self._linked: set[Robot] = set()
        self._agreed: dict[Robot, float] = {}
        self._can_flow: dict[TopicFlow, float] = {}
        self._said: dict[TopicFlow, tuple[float, tuple[str, ...]]] = {}
        self._next_sweep = _SWEEP_EVERY
        self._calls = CallInvariants(world)
        self.actions = ActionInvariants(world)

    async def watch(self) -> None:
        while True:
            await asyncio.sleep(self._random.uniform(*self._world.conditions.checks))
            self.check()

    def check(self) -> None:
        self.checks += 1
        world = self._world
        for robot in world.robots:
            self._check_linked(robot)
            self._check_agreement(robot)
            for flow in robot.topic_flows:
                self._check_topic(robot, flow)
                self._check_verdicts(robot, flow)
                self._check_lateness(robot, flow)
        self._check_ledgers()
        self._calls.check()
        self.actions.check()
        sweep = world.loop.time() >= self._next_sweep
        for run in world.runs():
            self._check_tasks(run)
            self._check_streams(run)
            if sweep:
                self._check_tables(run)
        if sweep:
            self._next_sweep = world.loop.time() + self._patience * _SWEEP_EVERY
            self._check_timers()

    def _check_streams(self, run: Run) -> None:
        """Check that a reliable topic has lost no message with a stream of its opening, nor while its link was away."""
        for link in run.links():
            for route in link.routes.values():
                if not (isinstance(route.half, Receiver) and isinstance(route.half.carried.channel, StreamReceiver)):
                    continue
                if route.fates[Lost.STREAM] is Fate.SENDS_AGAIN and (lost := route.half.carried.channel.counts().lost):
                    self._world.wrong(f"{run.host.name}: {route.key} lost {lost} messages with a stream")

    # --- links

    def _check_linked(self, robot: Robot) -> None:
        """Check that robots without trouble are linked within 15 s and stay linked, and that no other robot seems
        linked.
        """
        world, now = self._world, self._world.loop.time()
        ends = world.link_ends(robot)
        cut_off_at = world.cut_off_at(robot)
        if cut_off_at is not None and now - cut_off_at > self._patience * NOTICED_WITHIN and not robot.has_twin:
            for link in ends or ():
                if link.linked:
                    text = f"{robot.name} is cut off for {now - cut_off_at:.1f} s"
                    world.wrong(f"{text}, and seems linked with {link.end.address}")
        if ends is None or robot.troubles:
            self._linked.discard(robot)
            return
        waited = now - world.clear_since(robot)
        if all(link.linked for link in ends):
            if robot not in self._linked:
                self._linked.add(robot)
                self.worst_recovery = max(self.worst_recovery, waited)
        elif waited > self._patience * LINKED_WITHIN:
            here, there = ends
            world.wrong(
                f"{robot.name} can be linked since {waited:.1f} s, and is not: it says {here.down_reason!r}, "
                f"the server {there.down_reason!r}"
            )

    # --- routes

    def _check_agreement(self, robot: Robot) -> None:
        """Both sides have the same routes, and the same ones paused."""
        world, now = self._world, self._world.loop.time()
        ends = world.link_ends(robot)
        if ends is None or robot.troubles or not all(link.linked for link in ends):
            self._agreed[robot] = now
            return
        here, there = (
            {
                (route.topic, route.remote_topic): route.pausing.paused
                for route in link.routes.values()
                if not route.life.refusal
            }
            for link in ends
        )
        refused = {
            names
            for link in ends
            for route in link.routes.values()
            if route.life.refusal
            for names in ((route.topic, route.remote_topic),)
        }
        wrong = {
            names: (here.get(names), there.get(names))
            for names in here.keys() | there.keys()
            if here.get(names) != there.get(names) and names not in refused
        }
        if not wrong:
            self._agreed[robot] = now
        elif (
            now - max(self._agreed.get(robot, 0.0), world.clear_since(robot), robot.commanded)
            > self._patience * AGREED_WITHIN
        ):
            world.wrong(f"{robot.name} and the server disagree on which routes there are, and paused: {wrong}")

    def _check_topic(self, robot: Robot, flow: TopicFlow) -> None:
        world, now = self._world, self._world.loop.time()
        if not self._can_flow_now(robot, flow):
            self._can_flow.pop(flow, None)
            return
        began = (self._can_flow.setdefault(flow, now), flow.changed, robot.commanded, world.clear_since(robot))
        since = max(began) + self._patience * FLOWS_WITHIN
        if flow.latched:
            if not flow.ordered:
                return  # the newest may be lost
            waited = now - max(since, flow.last_sent)
            wrong = flow.sent > flow.newest.get(flow.life, 0) and waited > self._patience * FLOWS_WITHIN
        else:
            waited = now - max(since, flow.last_heard)
            wrong = waited > self._patience * FLOWS_WITHIN + 1.5 * flow.period
        if wrong:
            world.wrong(
                f"{flow} could flow for {waited:.1f} s, and does not: message {flow.sent} of life {flow.life} went in "
                f"{now - flow.last_sent:.1f} s ago, the newest that came out are {flow.newest}; {world.state(flow)}"
            )

    def _check_verdicts(self, robot: Robot, flow: TopicFlow) -> None:
        """Both sides show the same state of a topic, for the same cause, once they have told each other."""
        world, now = self._world, self._world.loop.time()
        ends = world.link_ends(robot)
        routes = [route_of(link, flow) for link in ends] if ends and all(link.linked for link in ends) else []
        runs = [run for run in (robot.host.run, world.server.run) if run is not None]
        shown = [
            each.judged.shown(run.process.context.copy().run(each.verdict)).verdict
            for run, each in zip(runs, routes, strict=False)
            if each is not None and each.life.accepted
        ]
        said = tuple([f"{each.state} {each.cause}" for each in shown])
        if robot.troubles or len(said) < 2 or len(set(said)) < 2:
            self._said.pop(flow, None)
            return
        since, before = self._said.setdefault(flow, (now, said))
        if before != said:
            self._said[flow] = now, said
        elif now - max(since, robot.commanded, world.clear_since(robot)) > self._patience * SAME_VERDICT_WITHIN:
            world.wrong(f"the two sides do not agree on {flow} since {now - since:.1f} s: {world.state(flow)}")

    def _check_lateness(self, robot: Robot, flow: TopicFlow) -> None:
        """No side shows a topic as ok while its messages keep coming out late."""
        world, now = self._world, self._world.loop.time()
        if flow.latched or flow.late < _LATE_MESSAGES or now - flow.last_heard > _COMES:
            return
        since = max(flow.late_since, robot.commanded)
        if world.conditions.outlive:  # what waited for its link is not late
            since = now if robot.troubles else max(since, world.clear_since(robot))
        lasted = now - since
        if lasted <= self._patience * LATE_WITHIN:
            return
        for link in world.link_ends(robot) or ():
            route = route_of(link, flow) if link.linked else None
            if route is not None and route.judged.shown(route.verdict()).verdict.state is State.OK:
                world.wrong(f"{flow} comes out late since {lasted:.1f} s, and {link.end.address} shows it as ok")

    def _can_flow_now(self, robot: Robot, flow: TopicFlow) -> bool:
        ends = self._world.link_ends(robot)
        if ends is None or robot.troubles or flow.troubles or not all(link.linked for link in ends):
            return False
        if flow.writer is None or flow.reader is None:
            return False
        routes = [route_of(link, flow) for link in ends]
        return all(route is not None and not route.pausing.paused for route in routes)

    # --- the ledger

    def _check_ledgers(self) -> None:
        """Check that the parts of each ledger sum up, that none is negative, and that they equal the flows' counts."""
        world = self._world
        current = {id(route) for run in world.runs() for link in run.links() for route in link.routes.values()}
        for sender, account in tuple(world.accounts.items()):
            if id(sender.route) in current:
                self._check_ledger(sender, account)
            else:
                del world.accounts[sender]

    def _check_ledger(self, sender: Sender, account: Account) -> None:
        world, now, route = self._world, self._world.loop.time(), sender.route
        ledger = sender.facts.ledger
        parts = (
            ledger.delivered,
            ledger.throttled,
            ledger.expired,
            ledger.unknown,
            ledger.waiting,
            ledger.in_flight,
            *ledger.dropped.values(),
        )
        untaken = ledger.lost_in_dds, ledger.missed_while_down, ledger.unsubscribed
        open_ends = ledger.unknown + ledger.waiting + ledger.in_flight
        wrong = ""
        if min(parts) < 0:
            wrong = "a part of it is negative"
        elif sum(parts) != ledger.offered:
            wrong = f"its parts sum up to {sum(parts)}"
        elif sum((ledger.offered - ledger.again, *untaken)) != (all_of_them := sum(account.newest.values())):
            wrong = f"{all_of_them} messages were published up to the newest that was taken"
        elif ledger.offered != account.offered and not sender.flow.is_latched:
            wrong = f"{account.offered} messages were taken"
        elif ledger.delivered > account.published:
            wrong = f"{account.published} messages were published"
        # Of two of one name, the one that has the link now knows nothing of the other's messages.
        elif ledger.unknown and not account.forgotten and not world.robot(route.peer.name).has_twin:
            wrong = "something is unknown, though the engine that published it still runs"
        # Datagrams may come after they were taken for lost.
        elif not route.lossy and ledger.delivered + open_ends < account.published - account.removed:
            wrong = f"{account.published} messages were published, and some of them are counted as lost"
        else:
            robot = world.robot(route.peer.name)
            last = max(account.last_offered, route.opened_at, world.clear_since(robot))
            if not robot.troubles and route.crossing.flows and now - last > self._patience * SETTLED_WITHIN:
                if ledger.delivered < account.published - account.unreported:
                    wrong = f"{account.published} messages were published, of which {account.unreported} may be unknown"
                elif ledger.delivered + ledger.unknown < account.published - account.removed:
                    wrong = f"{account.published} messages were published, and some of them are counted as lost"
                elif ledger.open:
                    wrong = f"nothing was sent for {now - last:.1f} s, and something is in flight"
        if wrong:
            side = "client" if route.peer.is_client else "server"
            world.wrong(f"the ledger of {route.key} on the {side} is wrong: {wrong}: {ledger}")

    # --- bounds

    def _check_tasks(self, run: Run) -> None:
        """No task dies unseen, and there are not more tasks and descriptors than topics explain."""
        world, name, process = self._world, run.host.name, run.process
        for failed_at, task in process.failed:
            if world.loop.time() - failed_at > _SEEN_WITHIN and task._log_traceback:
                world.wrong(f"{name}: a task has died, and nobody has looked: {task}")
        process.failed = [each for each in process.failed if world.loop.time() - each[0] <= _SEEN_WITHIN]
        links = run.links()
        most = 4 * (len(links) + sum(len(link.routes) for link in links))
        if len(process.tasks) > _TASKS + most:
            world.wrong(f"{name} has {len(process.tasks)} tasks: {list(process.tasks)}")
        if len(process.descriptors) > _DESCRIPTORS + most:
            world.wrong(f"{name} has {len(process.descriptors)} descriptors: {list(process.descriptors)}")

    def _check_tables(self, run: Run) -> None:
        links = run.links()
        most = _ITEMS + _ITEMS_EACH * (len(links) + sum(len(link.routes) for link in links))
        for way, length in tables(run.bridge).items():
            if length > max(most, next((bound for end, bound in _BOUNDED.items() if way.endswith(end)), 0)):
                self._world.wrong(f"{run.host.name} keeps {length} items in {way}")
        for link in links:
            unfinished = link.budget.unfinished.held
            if not link.routes and (unfinished or link.budget.kept.held):
                self._world.wrong(
                    f"{run.host.name}: without a route, {link.name} reports that it holds {unfinished} bytes "
                    f"of unfinished messages and {link.budget.kept.held} of latched ones"
                )

    def _check_timers(self) -> None:
        world = self._world
        timers = Counter(handle.program() for handle in world.loop.timers())
        for run in world.runs():
            links = run.links()
            most = _TIMERS + 4 * (len(links) + sum(len(link.routes) for link in links))
            if timers[run.process] > most:
                callbacks = Counter(str(each) for each in world.loop.timers() if each.program() is run.process)
                world.wrong(f"{run.host.name} has {timers[run.process]} timers: {callbacks.most_common(5)}")


def route_of(link: Link, flow: TopicFlow) -> Route | None:
    for route in link.routes.values():
        if route.topic == flow.near_name and route.from_client == (flow.topic.direction == "transmit"):
            return route
    return None
