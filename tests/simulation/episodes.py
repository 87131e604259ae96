"""Courses of events in a world: long waits, and rare coincidences."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from tests.simulation.faults import connections, move, reset
from tests.simulation.streams import StreamTransport
from tests.support import constants

from rsb_bridge.link.graph_watch import FOR_ROUTES
from rsb_bridge.link.refused_clients import ASKED_EVERY
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import PauseTopics, Retry, ShutDownLinks

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.simulation.world import World
    from tests.support.places import Place


async def server_away(world: World, seconds: float, *, machine: bool) -> None:
    """The server goes, and comes back.

    Args:
        machine: whether its machine is off, so that nobody even refuses.
    """
    await asyncio.sleep(60.0)
    with world.trouble("server away", *world.robots):
        if machine:
            world.server.power_off()
        else:
            world.server.kill()
        await asyncio.sleep(seconds)
        if machine:
            world.server.machine.power_on()
        world.server.start()


async def reopened(world: World) -> None:
    """Both sides open the action of a robot again and again, while its clients ask nothing twice."""
    (robot,) = world.robots
    for action in robot.action_flows:
        action.asks_again = False
    while True:
        await asyncio.sleep(40.0)
        robot.commanded = world.loop.time()  # it is not offered for a moment
        for link in world.link_ends(robot) or ():
            for route in link.routes.values():
                if route.outgoing and route.proposal.kind == "action":
                    route.request_reopen(EventCode.ROUTE_CHANNEL_LOST, "its opening ends")


async def tunnelled(world: World, seconds: float, speed: float = 5_000.0, fresh_within: float = 6.0) -> None:
    """A robot's only way is a tunnel that carries a third of what its topics bring, and has room for minutes of it.

    Args:
        fresh_within: s, the greatest age of a message on arrival.
    """
    (robot,) = world.robots
    ends = robot.host.machine, world.server.machine
    for machine in ends:
        machine.stream_buffer = 4 << 20
    await asyncio.sleep(20.0)
    for path in world.network.both_ways(*ends):
        path.bandwidth = speed
    with world.trouble("tunnel", robot):  # it may look slow, and it may be given up: its messages stay fresh
        for flow in robot.topic_flows:
            flow.vanish()
            flow.fresh_within = fresh_within
            flow.size, flow.period = 500, 500 * len(robot.topic_flows) / (3 * speed)
            flow.appear()
        await asyncio.sleep(seconds)
        for flow in robot.topic_flows:
            flow.vanish()
        for path in world.network.both_ways(*ends):
            path.bandwidth = None


async def delayed(world: World, seconds: float, delay: float = 3.0) -> None:
    """Everything between a robot and the server takes some seconds, as through a satellite or a buffer on the way."""
    (robot,) = world.robots
    await asyncio.sleep(20.0)
    for flow in robot.topic_flows:
        flow.vanish()
        flow.size, flow.period = 100, 0.4
        flow.appear()
    await asyncio.sleep(20.0)
    paths = world.network.both_ways(robot.host.machine, world.server.machine)
    for path in paths:
        path.latency = (delay, delay + 0.01)
    with world.trouble("delayed", robot):
        await asyncio.sleep(seconds)
    for path in paths:
        path.mend()


async def aged(world: World, rounds: int = 25) -> None:
    """Messages are held up in all ways that there are, while clocks are set; none may come out that is too old."""
    random = world.random("ages")
    (robot,), (flow,) = world.robots, world.topic_flows.values()
    ends = robot.host.machine, world.server.machine
    ways = world.network.both_ways(*ends)
    await asyncio.sleep(10.0)
    with world.trouble("ages", robot):
        for _ in range(rounds):
            await asyncio.sleep(random.uniform(1.0, 8.0))
            seconds = random.choice((random.uniform(0.1, 1.0), random.uniform(1.0, 8.0)))
            whats = ["hold", "hold one way", "cut", "narrow", "freeze", "step", "kill"]
            whats += ["pause"] if flow.ordered else []  # datagrams: what is paused is judged in its own process only
            what = random.choice(whats)
            world.log.fault(what)
            slow = ways if what == "hold" else ways[:1] if random.random() < 0.5 else ways[1:]
            match what:
                case "hold" | "hold one way":
                    for path in slow:
                        path.latency = (seconds, seconds + 0.5)
                case "cut":
                    world.network.cut(*ends)
                case "narrow":
                    for path in ways:
                        path.bandwidth = 2_000.0
                case (
                    "freeze"
                ):  # of the ROS thread: the messages that it takes then are as old as that, and get new stamps
                    flow.near.taking = (seconds, seconds)
                case "pause":
                    await _pause_all(world, paused=True)
                case "kill":
                    random.choice((robot.host, world.server)).kill()
            if what == "step" or random.random() < 0.5:
                await asyncio.sleep(random.uniform(0.0, 0.5))
                clock = random.choice((robot.host, world.server)).clock
                clock.offset += random.choice((-1, 1)) * 10 ** random.uniform(-1.5, 2)
            await asyncio.sleep(seconds)
            flow.near.taking = (0.0001, 0.002)
            world.network.heal(*ends)
            for path in ways:
                path.mend()
            for host in (robot.host, world.server):
                if host.run is None:
                    host.start()
            await _pause_all(world, paused=False)
        await asyncio.sleep(30.0)


async def linked_by_a_slow_way(world: World) -> None:
    """The link comes up while one direction takes longer than `max_age`: the offset of the clocks is measured wrong."""
    (robot,) = world.robots
    ends = robot.host.machine, world.server.machine
    await asyncio.sleep(10.0)
    with world.trouble("a slow way", robot):
        for slow in world.network.both_ways(*ends):
            slow.latency = (0.55, 0.65)
            robot.host.kill()
            await asyncio.sleep(1.0)
            robot.host.start()
            await asyncio.sleep(60.0)
            slow.mend()
        await asyncio.sleep(30.0)


async def _pause_all(world: World, *, paused: bool) -> None:
    run = world.server.run
    for link in run.links() if run is not None else ():
        for half in tuple(link.routes.values()):
            if run is not None and half.pausing.paused != paused:
                world.robots[0].commanded = world.loop.time()
                await run.command(run.bridge.do(PauseTopics(half.key, paused=paused)))


async def paused_while_away(world: World) -> None:
    """An operator pauses all topics, or resumes them, while a robot's link is away."""
    (robot,) = world.robots
    ends = robot.host.machine, world.server.machine
    paused = False
    while True:
        await asyncio.sleep(60.0)
        with world.trouble("cut", robot):
            world.network.cut(*ends)
            await asyncio.sleep(12.0)
            paused = not paused
            await _pause_all(world, paused=paused)
            world.network.heal(*ends)


async def server_restarts(world: World, times: int) -> None:
    for _ in range(times):
        await asyncio.sleep(60.0)
        with world.trouble("server stopped", *world.robots):
            await world.server.stop()
            await asyncio.sleep(10.0)
            world.server.start()


async def shut_down_for(world: World, seconds: float, *, cuts: int) -> None:
    """An operator of the server shuts its links down, and lets the robots in again.

    Args:
        cuts: how often a robot's network goes for a minute meanwhile.
    """
    await asyncio.sleep(60.0)
    server, robot = world.server.run, world.robots[0]
    assert server is not None
    with world.trouble("shut down", *world.robots, fault=False):
        await server.command(server.bridge.do(ShutDownLinks()))
        for _ in range(cuts):
            await asyncio.sleep(seconds / cuts - 60.0)
            world.network.cut(robot.host.machine, world.server.machine)
            await asyncio.sleep(60.0)
            world.network.heal(robot.host.machine, world.server.machine)
        await asyncio.sleep(0.0 if cuts else seconds)
        await server.command(server.bridge.do(Retry()))
        await asyncio.sleep(1.2 * ASKED_EVERY)


async def client_restarts(world: World, times: int) -> None:
    robot = world.robots[0]
    for _ in range(times):
        await asyncio.sleep(60.0)
        with world.trouble("client stopped", robot):
            await robot.host.stop()
            await asyncio.sleep(10.0)
            robot.host.start()


async def type_differs_for(world: World, seconds: float) -> None:
    """The two sides disagree on what a type is from the beginning, so that its topic is refused; then they agree."""
    flow = world.robots[0].topic_flows[0]
    with world.flow_trouble(flow, "type differs"):
        flow.update_listener(1)
        await asyncio.sleep(seconds)
        flow.update_listener(0)


async def restarted_while_cut(world: World) -> None:
    """A robot's network comes and goes, and its engine is killed and started again around that."""
    random = world.random("restarts")
    robot = world.robots[0]
    ends = robot.host.machine, world.server.machine
    with world.trouble("restarted while cut", robot):
        while True:
            await asyncio.sleep(random.uniform(1.0, 6.0))
            world.network.cut(*ends)
            if random.random() < 0.2:
                robot.host.kill()
                await asyncio.sleep(random.uniform(0.0, 2.0))
                robot.host.start()
            await asyncio.sleep(random.uniform(0.0, 8.0))
            world.network.heal(*ends)


async def connections_reset(world: World) -> None:
    """A firewall resets some of a robot's connections, again and again."""
    random = world.random("resets")
    while True:
        await asyncio.sleep(random.uniform(5.0, 30.0))
        await reset(world, random.choice(world.robots), random)


async def connections_forgotten(world: World) -> None:
    """Have a robot's connections carry nothing any more, without a word; now and then, have it move instead."""
    random = world.random("forgotten connections")
    while True:
        await asyncio.sleep(random.uniform(5.0, 30.0))
        robot = random.choice(world.robots)
        if random.random() < 0.3:
            await move(world, robot, random)
            continue
        held = robot.host.run.process.descriptors if robot.host.run is not None else ()
        with world.trouble("forgotten connections", robot):
            for each in held:
                if isinstance(each, StreamTransport):
                    each.forgotten = True
            await asyncio.sleep(3.0)


@contextlib.contextmanager
def slow_motion(tick: float) -> Iterator[None]:
    """Slow the engines' periodic work from once a second to once in `tick` s, and repeat refused requests no more
    often.

    A month of pings, answers, reports and refusals alone would take ten minutes, and is none of what a month is about.
    """
    slower: dict[Place, object] = {
        constants.TICK: tick,
        constants.SIMULATED_SNAPSHOT_EVERY: tick,
        constants.GRAPH_LOOKS: FOR_ROUTES._replace(always_after=tick),
        constants.DEAD_AFTER: 5 * tick,
        constants.ROUTE_LONGEST_PAUSE: tick,
    }
    with contextlib.ExitStack() as stack:
        for constant, value in slower.items():
            stack.enter_context(constant.during(value))
        yield


async def data_connections_break(world: World, times: int) -> None:
    """Something between keeps what the data connections carry, and resets them after 3 s, the large one first."""
    (robot,) = world.robots
    for _ in range(times):
        assert robot.host.run is not None
        (link,) = robot.host.run.links()
        pair = link.channels.pair_of("tcp", link.shared_port())
        assert pair is not None
        of_stream = {each.get_protocol(): each for each in connections(robot)}
        ends = [of_stream[each.stream] for each in reversed(pair.streams())]
        with world.trouble("data connections", robot):
            for each in ends:
                each.forget(told=False)
            await asyncio.sleep(3.0)
            for each in ends:
                each.reset()
                await asyncio.sleep(0.1)
        await asyncio.sleep(20.0)


async def path_is_cut(world: World, times: int) -> None:
    """Cut the path for shorter and longer than a silent connection lives."""
    (robot,), random = world.robots, world.random("cuts")
    ends = robot.host.machine, world.server.machine
    for _ in range(times):
        with world.trouble("the path is cut", robot):
            world.network.cut(*ends)
            await asyncio.sleep(random.uniform(0.3, 12.0))
            world.network.heal(*ends)
        await asyncio.sleep(random.uniform(8.0, 16.0))
