"""Faults of a world: of the network, machines and processes, clocks and names, and of ROS.

Each fault is a coroutine that breaks something for one robot, or for the server and so for all, and mends it again.
While it lasts, and only then, the robots concerned may be unlinked (`World.trouble`). Faults of one robot follow each
other; faults of different robots, and the server's, overlap.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeAlias

import msgspec
from tests.simulation.streams import StreamTransport

from rsb_bridge.config.keys import Key

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator, Sequence
    from random import Random

    from tests.simulation.action_flow import ActionFlow
    from tests.simulation.engine_host import EngineHost
    from tests.simulation.service_flow import ServiceFlow
    from tests.simulation.services import Client, Server
    from tests.simulation.topic_flow import TopicFlow
    from tests.simulation.world import Robot, World

    Fault: TypeAlias = Callable[[World, Any, Random], Coroutine[None, None, None]]

_MINUTE, _HOUR = 60.0, 3600.0
_NIGHT = 7.5 * _HOUR
"""s, of a robot, on average."""
_SLOW_ANSWERS = 20.0
"""s that an answer of a slow server takes at most."""
_LATEST = 25.0
"""s until the last packet has arrived that was sent over a bad network."""


def duration(random: Random) -> float:
    """Draw the duration (s) of a fault: mostly seconds, sometimes hours."""
    return random.choices(
        (
            random.uniform(0.05, 1.0),
            random.uniform(1.0, 8.0),
            random.uniform(8.0, _MINUTE),
            random.uniform(1.0, 20.0) * _MINUTE,
            random.uniform(1.0, 8.0) * _HOUR,
        ),
        (20, 40, 30, 9, 1),
    )[0]


# --- the network between a robot and the server


async def cut(world: World, robot: Robot, random: Random) -> None:
    """A cable is pulled, and put back."""
    with world.trouble("cut", robot):
        world.network.cut(robot.host.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.network.heal(robot.host.machine, world.server.machine)


async def cut_one_way(world: World, robot: Robot, random: Random) -> None:
    ends = [robot.host.machine, world.server.machine]
    random.shuffle(ends)
    with world.trouble("one-way cut", robot):
        world.network.cut_one_way(*ends)
        await asyncio.sleep(duration(random))
        world.network.heal(*ends)


async def flap(world: World, robot: Robot, random: Random) -> None:
    with world.trouble("flapping", robot):
        for _ in range(random.randrange(3, 40)):
            world.network.cut(robot.host.machine, world.server.machine)
            await asyncio.sleep(random.choice((3.0, random.uniform(0.0, 6.0))))
            world.network.heal(robot.host.machine, world.server.machine)
            await asyncio.sleep(random.choice((3.0, random.uniform(0.0, 6.0))))


async def bad_network(world: World, robot: Robot, random: Random) -> None:
    """Packets are late, lost, doubled, in another order, large ones do not fit, and there is little room."""
    paths = world.network.both_ways(robot.host.machine, world.server.machine)
    with world.trouble("bad network", robot):
        for path in paths:
            shortest = 10 ** random.uniform(-4, 0)
            path.latency = (shortest, shortest * random.uniform(1.0, 20.0))
            path.loss = random.choice((0.0, random.uniform(0.0, 0.5)))
            path.duplicates = random.choice((0.0, random.uniform(0.0, 0.3)))
            path.bandwidth = random.choice((None, None, 10 ** random.uniform(3.5, 6)))
            path.mtu = random.choice((1500, 1500, 1280, 576))
        await asyncio.sleep(duration(random))
        for path in paths:
            path.mend()
        await asyncio.sleep(_LATEST)


def connections(robot: Robot) -> list[StreamTransport]:
    held = robot.host.run.process.descriptors if robot.host.run is not None else ()
    return [each for each in held if isinstance(each, StreamTransport)]


async def reset(world: World, robot: Robot, random: Random) -> None:
    """A firewall between resets some of the robot's connections."""
    found = connections(robot)
    with world.trouble("reset", robot):
        for each in random.sample(found, random.randint(0, len(found))):
            each.reset()
        await asyncio.sleep(1.0)


async def half_open(world: World, robot: Robot, random: Random) -> None:
    """A NAT between forgets the robot's connections; none or one of the two ends of each hears of it."""
    with world.trouble("half-open", robot):
        for each in connections(robot):
            random.choice((each, each.peer)).forget(told=random.random() < 0.3)
        await asyncio.sleep(1.0)


async def refused(world: World, robot: Robot, random: Random) -> None:
    with world.trouble("refused connects", *world.robots):
        world.server.machine.refuses = True
        world.network.cut(robot.host.machine, world.server.machine)
        await asyncio.sleep(7.0)
        world.network.heal(robot.host.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.server.machine.refuses = False


async def no_such_name(world: World, robot: Robot, random: Random) -> None:
    """The name server does not know the server's name, or does not answer at all."""
    name = robot.host.session.server_ip
    if name not in world.network.names:
        return
    addresses = world.network.names[name]
    with world.trouble("no such name", *world.robots):
        if random.random() < 0.5:
            del world.network.names[name]
        else:
            world.network.names[name] = None
        world.network.cut(robot.host.machine, world.server.machine)
        await asyncio.sleep(random.uniform(1.0, 10.0))
        world.network.heal(robot.host.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.network.names[name] = addresses


async def move(world: World, robot: Robot, random: Random) -> None:
    """The robot gets another address, as a phone does between two networks."""
    machine = robot.host.machine
    with world.trouble("another address", robot):
        machine.move(f"10.{random.randrange(1, 200)}.{random.randrange(256)}.{machine.address.rpartition('.')[2]}")


# --- machines and processes


def _machine(world: World, robot: Robot | None) -> tuple[EngineHost, Sequence[Robot]]:
    """Return a robot's machine, or the server's, and the robots that lose their link with it."""
    return (world.server, world.robots) if robot is None else (robot.host, (robot,))


async def kill(world: World, robot: Robot | None, random: Random) -> None:
    host, concerned = _machine(world, robot)
    with world.trouble("killed", *concerned):
        host.kill()
        await asyncio.sleep(random.choice((0.0, duration(random))))
        host.start()


async def power_cut(world: World, robot: Robot | None, random: Random) -> None:
    host, concerned = _machine(world, robot)
    with world.trouble("switched off", *concerned):
        host.power_off()
        await asyncio.sleep(duration(random))
        host.machine.power_on()
        await asyncio.sleep(random.choice((0.0, random.uniform(0.0, 30.0))))
        host.start()


async def upgrade(world: World, robot: Robot | None, random: Random) -> None:
    host, concerned = _machine(world, robot)
    with world.trouble("restarted", *concerned):
        await host.stop()
        await asyncio.sleep(duration(random))
        host.start()


async def night(world: World, robot: Robot, random: Random) -> None:
    with world.trouble("switched off for the night", robot):
        await robot.host.stop()
        robot.host.power_off()
        await asyncio.sleep(random.uniform(0.4, 1.6) * _NIGHT)
        robot.host.machine.power_on()
        robot.host.start()


async def twin(world: World, robot: Robot, random: Random) -> None:
    """A second client of the same name and key comes, and goes."""
    with world.trouble("two of one name", robot), world.twin(robot) as host:
        host.start()
        await asyncio.sleep(random.uniform(1.0, 2.0 * _MINUTE))
        if random.random() < 0.5:
            host.kill()
        else:
            await host.stop()


async def wrong_key(world: World, robot: Robot, random: Random) -> None:
    """The robot is started with a wrong key, or a name that the server does not know, until somebody sees it."""
    host = robot.host
    session, keys = host.session, host.keys
    with world.trouble("wrong key or name", robot):
        await host.stop()
        if () in keys.values() or random.random() < 0.5:
            host.session = msgspec.structs.replace(session, name="stranger")
            host.keys = {"stranger": keys[session.name]}
        else:
            host.keys = {session.name: (Key(random.randbytes(32)),)}
        host.start()
        await asyncio.sleep(duration(random))
        await host.stop()
        host.session, host.keys = session, keys
        host.start()


# --- clocks


def _set_clock(world: World, host: EngineHost, random: Random) -> None:
    """Somebody, or NTP, sets a wall clock: by milliseconds, or by years."""
    world.log.fault("clock set")
    step = random.choice((-1, 1)) * 10 ** random.uniform(-3, 8)
    host.clock.offset = min(max(host.clock.offset + step, -1e9), 1e9)
    world.log.tell(f"{host.name}: its clock is set by {step:.3f} s")


# --- ROS


async def publisher_gone(world: World, flow: TopicFlow, random: Random) -> None:
    with world.flow_trouble(flow, "publisher gone"):
        flow.vanish()
        await asyncio.sleep(duration(random))
        flow.appear()


async def listener_gone(world: World, flow: TopicFlow, random: Random) -> None:
    with world.flow_trouble(flow, "listener gone"):
        flow.deafen()
        await asyncio.sleep(duration(random))
        flow.listen()


async def type_differs(world: World, flow: TopicFlow, random: Random) -> None:
    with world.flow_trouble(flow, "type differs"):
        flow.update_listener(1)
        await asyncio.sleep(random.choice((duration(random), random.uniform(0.1, 4.0) * _HOUR)))
        flow.update_listener(0)


async def take_fails(world: World, flow: TopicFlow, random: Random) -> None:
    with world.flow_trouble(flow, "take fails"):
        for reader in tuple(flow.near.readers(flow.near_name)):
            reader.fail()


async def server_ends(world: World, service: ServiceFlow | ActionFlow, random: Random) -> None:
    with world.flow_trouble(service, "server gone"):
        service.vanish()
        await asyncio.sleep(duration(random))
        service.appear()


async def server_dies(world: World, service: ServiceFlow | ActionFlow, random: Random) -> None:
    """A node that serves is killed, which others see late, and is started again."""
    with world.flow_trouble(service, "server killed"):
        service.vanish(killed=True)
        await asyncio.sleep(random.choice((duration(random), random.uniform(0.0, 2.0))))
        service.appear()


async def server_hesitates(world: World, service: ServiceFlow | ActionFlow, random: Random) -> None:
    """A node that serves takes its time, and leaves some calls without an answer."""
    with world.flow_trouble(service, "slow server"):
        service.hesitate(slow=True)
        await asyncio.sleep(random.uniform(1.0, 60.0))
        service.hesitate(slow=False)
        await asyncio.sleep(_SLOW_ANSWERS)


async def caller_restarts(world: World, service: ServiceFlow | ActionFlow, random: Random) -> None:
    world.log.fault("caller restarts")
    service.call()
    await asyncio.sleep(random.uniform(0.0, 1.0))


async def offer_fails(world: World, service: ServiceFlow | ActionFlow, random: Random) -> None:
    """The middleware fails to take from the bridge's server, or from its client."""
    with world.flow_trouble(service, "taking calls fails"):
        near, far = service.near.services, service.far.services
        lane = random.randrange(len(service.near_services)) if len(service.near_services) > 1 else 0
        servers = near.servers[service.near_services[lane]]
        clients = far.clients[service.far_services[lane]]
        ends: tuple[tuple[Server | Client, ...], ...] = (tuple(servers), tuple(clients))
        for end in random.choice(ends):
            if end.node.startswith("/_rsb_"):
                end.fail()


async def busy_ros(world: World, flow: TopicFlow, random: Random) -> None:
    """The ROS thread has much to do, while a burst of messages comes."""
    world.log.fault("burst")
    before = flow.near.taking
    flow.near.taking = random.choice((before, (0.0, 0.2)))
    for _ in range(random.randrange(10, 200)):
        flow.publish()
        await asyncio.sleep(random.choice((0.0, random.uniform(0.0, 0.05))))
    flow.near.taking = before


# --- all of it

_ROBOT: dict[Fault, int] = {
    cut: 8,
    cut_one_way: 3,
    flap: 2,
    reset: 3,
    bad_network: 5,
    refused: 1,
    no_such_name: 1,
    move: 3,
    kill: 5,
    power_cut: 4,
    upgrade: 3,
    twin: 1,
    wrong_key: 1,
}
_CONNECTIONS: dict[Fault, int] = {reset: 3, half_open: 3, move: 2, cut: 2}
"""Of its connections alone."""
_SERVER: dict[Fault, int] = {kill: 3, power_cut: 2, upgrade: 2}
_EXCHANGE: dict[Fault, int] = {server_ends: 3, server_dies: 3, server_hesitates: 3, caller_restarts: 2, offer_fails: 1}
_FLOW: dict[Fault, int] = {publisher_gone: 4, listener_gone: 2, type_differs: 1, take_fails: 1, busy_ros: 4}


def of(world: World) -> Iterator[Coroutine[None, None, None]]:
    pause = world.conditions.faults
    if pause:
        yield _befall(world, "the server", 5 * pause, _SERVER, lambda _: None)
        yield _set_clocks(world, 3 * pause)
        for robot in world.robots:
            yield _befall_robot(world, robot, pause)
            if world.conditions.moves:
                yield _befall_connections(world, robot, world.conditions.moves)
            yield _befall_flows(world, robot, pause)
            if robot.service_flows or robot.action_flows:
                yield _befall_services(world, robot, pause)


async def _befall(
    world: World, whose: str, pause: float, faults: dict[Fault, int], victim: Callable[[Random], object]
) -> None:
    """One fault after another, with a pause (s, on average) between them."""
    random = world.random(f"faults of {whose}")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(faults), tuple(faults.values()))
        await fault(world, victim(random), random)


async def _befall_robot(world: World, robot: Robot, pause: float) -> None:
    """One fault of a robot's after another, with a pause (s, on average) between them."""
    random = world.random(f"faults of {robot.name}")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(_ROBOT), tuple(_ROBOT.values()))
        await fault(world, robot, random)
        nights = world.conditions.nights
        if nights and random.random() < nights / (1 - nights) * pause / _NIGHT:
            await night(world, robot, random)


def _befall_connections(world: World, robot: Robot, pause: float) -> Coroutine[None, None, None]:
    return _befall(world, f"{robot.name}'s connections", pause, _CONNECTIONS, lambda _: robot)


def _befall_flows(world: World, robot: Robot, pause: float) -> Coroutine[None, None, None]:
    whose = f"{robot.name}'s topics"
    return _befall(world, whose, pause, _FLOW, lambda random: random.choice(robot.topic_flows))


def _befall_services(world: World, robot: Robot, pause: float) -> Coroutine[None, None, None]:
    def victim(random: Random) -> ServiceFlow | ActionFlow:
        called: list[ServiceFlow | ActionFlow] = [*robot.service_flows, *robot.action_flows]
        return random.choice(called)

    return _befall(world, f"{robot.name}'s services", pause, _EXCHANGE, victim)


async def _set_clocks(world: World, pause: float) -> None:
    random = world.random("clocks")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        _set_clock(world, random.choice([world.server, *(robot.host for robot in world.robots)]), random)
