"""What goes wrong in a world: on the network, with machines and processes, with clocks and names, in ROS.

Each fault is a coroutine that does something to one robot, or to the server and so to all, and mends it again. While it
lasts, and only then, the robots concerned need not be linked (`World.trouble`). Faults of one robot follow each other;
those of different robots, and the server's, come at the same time.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.keys import Key

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator
    from random import Random

    from tests.simulation.errands import Errand
    from tests.simulation.exchanges import Exchange
    from tests.simulation.flows import Flow
    from tests.simulation.services import Client, Server
    from tests.simulation.station import Station
    from tests.simulation.world import Robot, World

_MINUTE, _HOUR = 60.0, 3600.0
_NIGHT = 7.5 * _HOUR
"""s, of a robot, on average."""
_SLOW_ANSWERS = 20.0
"""s that an answer of a slow server takes at most."""
_LATEST = 25.0
"""s until the last packet has arrived that was sent over a bad network."""


def duration(random: Random) -> float:
    """How long (s) something is broken: mostly seconds, sometimes hours."""
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
        world.network.cut(robot.station.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.network.heal(robot.station.machine, world.server.machine)


async def cut_one_way(world: World, robot: Robot, random: Random) -> None:
    """What one side sends does not arrive, while it hears the other."""
    ends = [robot.station.machine, world.server.machine]
    random.shuffle(ends)
    with world.trouble("one-way cut", robot):
        world.network.cut_one_way(*ends)
        await asyncio.sleep(duration(random))
        world.network.heal(*ends)


async def flap(world: World, robot: Robot, random: Random) -> None:
    """The network comes and goes every 3 s."""
    with world.trouble("flapping", robot):
        for _ in range(random.randrange(3, 40)):
            world.network.cut(robot.station.machine, world.server.machine)
            await asyncio.sleep(random.choice((3.0, random.uniform(0.0, 6.0))))
            world.network.heal(robot.station.machine, world.server.machine)
            await asyncio.sleep(random.choice((3.0, random.uniform(0.0, 6.0))))


async def bad_network(world: World, robot: Robot, random: Random) -> None:
    """Packets are late, lost, doubled, in another order, large ones do not fit, and there is little room."""
    paths = world.network.both_ways(robot.station.machine, world.server.machine)
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


async def refused(world: World, robot: Robot, random: Random) -> None:
    """A firewall at the server refuses connections."""
    with world.trouble("refused connects", *world.robots):
        world.server.machine.refuses = True
        world.network.cut(robot.station.machine, world.server.machine)
        await asyncio.sleep(7.0)
        world.network.heal(robot.station.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.server.machine.refuses = False


async def no_such_name(world: World, robot: Robot, random: Random) -> None:
    """The name server does not know the server's name, or does not answer at all."""
    name = robot.station.session.server_ip
    if name not in world.network.names:
        return
    addresses = world.network.names[name]
    with world.trouble("no such name", *world.robots):
        if random.random() < 0.5:
            del world.network.names[name]
        else:
            world.network.names[name] = None
        world.network.cut(robot.station.machine, world.server.machine)
        await asyncio.sleep(random.uniform(1.0, 10.0))
        world.network.heal(robot.station.machine, world.server.machine)
        await asyncio.sleep(duration(random))
        world.network.names[name] = addresses


async def move(world: World, robot: Robot, random: Random) -> None:
    """The robot gets another address, as a phone does between two networks."""
    machine = robot.station.machine
    with world.trouble("another address", robot):
        machine.move(f"10.{random.randrange(1, 200)}.{random.randrange(256)}.{machine.address.rpartition('.')[2]}")


# --- machines and processes


async def kill(world: World, robot: Robot, random: Random) -> None:
    """The robot's engine is killed, and started again."""
    with world.trouble("client killed", robot):
        robot.station.kill()
        await asyncio.sleep(random.choice((0.0, duration(random))))
        robot.station.start()


async def power_cut(world: World, robot: Robot, random: Random) -> None:
    """The robot is switched off, and on again."""
    with world.trouble("client switched off", robot):
        robot.station.power_off()
        await asyncio.sleep(duration(random))
        robot.station.machine.power_on()
        await asyncio.sleep(random.choice((0.0, random.uniform(0.0, 30.0))))
        robot.station.start()


async def night(world: World, robot: Robot, random: Random) -> None:
    """The robot is switched off for hours, and on again."""
    with world.trouble("client switched off for the night", robot):
        await robot.station.stop()
        robot.station.power_off()
        await asyncio.sleep(random.uniform(0.4, 1.6) * _NIGHT)
        robot.station.machine.power_on()
        robot.station.start()


async def upgrade(world: World, robot: Robot, random: Random) -> None:
    """The robot's engine is stopped in good order, and started again, while the others run."""
    with world.trouble("client restarted", robot):
        await robot.station.stop()
        await asyncio.sleep(duration(random))
        robot.station.start()


async def twin(world: World, robot: Robot, random: Random) -> None:
    """A second client of the same name and key comes, and goes."""
    with world.trouble("two of one name", robot), world.twin(robot) as station:
        station.start()
        await asyncio.sleep(random.uniform(1.0, 2.0 * _MINUTE))
        if random.random() < 0.5:
            station.kill()
        else:
            await station.stop()


async def wrong_key(world: World, robot: Robot, random: Random) -> None:
    """The robot is started with a wrong key, or a name that the server does not know, until somebody sees it."""
    station = robot.station
    session, keys = station.session, station.keys
    with world.trouble("wrong key or name", robot):
        await station.stop()
        if () in keys.values() or random.random() < 0.5:
            station.session = msgspec.structs.replace(session, name="stranger")
            station.keys = {"stranger": keys[session.name]}
        else:
            station.keys = {session.name: (Key(random.randbytes(32)),)}
        station.start()
        await asyncio.sleep(duration(random))
        await station.stop()
        station.session, station.keys = session, keys
        station.start()


async def server_killed(world: World, random: Random) -> None:
    """The server's engine is killed, and started again."""
    with world.trouble("server killed", *world.robots):
        world.server.kill()
        await asyncio.sleep(random.choice((0.0, duration(random))))
        world.server.start()


async def server_off(world: World, random: Random) -> None:
    """The server is switched off, and on again."""
    with world.trouble("server switched off", *world.robots):
        world.server.power_off()
        await asyncio.sleep(duration(random))
        world.server.machine.power_on()
        await asyncio.sleep(random.choice((0.0, random.uniform(0.0, 30.0))))
        world.server.start()


async def server_upgrade(world: World, random: Random) -> None:
    """The server's engine is stopped in good order, and started again, while the clients run."""
    with world.trouble("server restarted", *world.robots):
        await world.server.stop()
        await asyncio.sleep(duration(random))
        world.server.start()


# --- clocks


def _set_clock(world: World, station: Station, random: Random) -> None:
    """Somebody, or NTP, sets a wall clock: by milliseconds, or by years."""
    world.chronicle.fault("clock set")
    step = random.choice((-1, 1)) * 10 ** random.uniform(-3, 8)
    station.clock.offset = min(max(station.clock.offset + step, -1e9), 1e9)
    world.chronicle.tell(f"{station.name}: its clock is set by {step:.3f} s")


# --- ROS


async def publisher_gone(world: World, flow: Flow, random: Random) -> None:
    """A node that publishes ends, and is started again."""
    with world.flow_trouble(flow, "publisher gone"):
        flow.vanish()
        await asyncio.sleep(duration(random))
        flow.appear()


async def listener_gone(world: World, flow: Flow, random: Random) -> None:
    """A node that subscribes ends, and is started again."""
    with world.flow_trouble(flow, "listener gone"):
        flow.deafen()
        await asyncio.sleep(duration(random))
        flow.listen()


async def type_differs(world: World, flow: Flow, random: Random) -> None:
    """The two sides have different versions of a type installed, for long."""
    with world.flow_trouble(flow, "type differs"):
        flow.update_sink(1)
        await asyncio.sleep(random.choice((duration(random), random.uniform(0.1, 4.0) * _HOUR)))
        flow.update_sink(0)


async def take_fails(world: World, flow: Flow, random: Random) -> None:
    """The middleware fails to take from the bridge's subscription."""
    with world.flow_trouble(flow, "take fails"):
        for reader in tuple(flow.source.readers(flow.source_topic)):
            reader.fail()


async def server_ends(world: World, exchange: Exchange | Errand, random: Random) -> None:
    """A node that serves ends, and is started again."""
    with world.flow_trouble(exchange, "server gone"):
        exchange.vanish()
        await asyncio.sleep(duration(random))
        exchange.appear()


async def server_dies(world: World, exchange: Exchange | Errand, random: Random) -> None:
    """A node that serves is killed, which others see late, and is started again."""
    with world.flow_trouble(exchange, "server killed"):
        exchange.vanish(killed=True)
        await asyncio.sleep(random.choice((duration(random), random.uniform(0.0, 2.0))))
        exchange.appear()


async def server_hesitates(world: World, exchange: Exchange | Errand, random: Random) -> None:
    """A node that serves takes its time, and leaves some calls without an answer."""
    with world.flow_trouble(exchange, "slow server"):
        exchange.hesitate(slow=True)
        await asyncio.sleep(random.uniform(1.0, 60.0))
        exchange.hesitate(slow=False)
        await asyncio.sleep(_SLOW_ANSWERS)


async def caller_restarts(world: World, exchange: Exchange | Errand, random: Random) -> None:
    """A node that calls ends, with calls under way, and is started again."""
    world.chronicle.fault("caller restarts")
    exchange.call()
    await asyncio.sleep(random.uniform(0.0, 1.0))


async def offer_fails(world: World, exchange: Exchange | Errand, random: Random) -> None:
    """The middleware fails to take from the bridge's server, or from its client."""
    with world.flow_trouble(exchange, "taking calls fails"):
        near, far = exchange.near.services, exchange.far.services
        service = random.randrange(len(exchange.near_services)) if len(exchange.near_services) > 1 else 0
        servers = near.servers[exchange.near_services[service]]
        clients = far.clients[exchange.far_services[service]]
        ends: tuple[tuple[Server | Client, ...], ...] = (tuple(servers), tuple(clients))
        for end in random.choice(ends):
            if end.node.startswith("/rsb_"):
                end.fail()


async def busy_ros(world: World, flow: Flow, random: Random) -> None:
    """The ROS thread has much to do, while a burst of messages comes."""
    world.chronicle.fault("burst")
    before = flow.source.taking
    flow.source.taking = random.choice((before, (0.0, 0.2)))
    for _ in range(random.randrange(10, 200)):
        flow.publish()
        await asyncio.sleep(random.choice((0.0, random.uniform(0.0, 0.05))))
    flow.source.taking = before


# --- all of it

_ROBOT = {
    cut: 8,
    cut_one_way: 3,
    flap: 2,
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
_SERVER = {server_killed: 3, server_off: 2, server_upgrade: 2}
_EXCHANGE = {server_ends: 3, server_dies: 3, server_hesitates: 3, caller_restarts: 2, offer_fails: 1}
_FLOW = {publisher_gone: 4, listener_gone: 2, type_differs: 1, take_fails: 1, busy_ros: 4}


def of(world: World) -> Iterator[Coroutine[None, None, None]]:
    """All that goes wrong in a world, as its climate has it."""
    pause = world.climate.faults
    if pause:
        yield _befall_server(world, 5 * pause)
        yield _set_clocks(world, 3 * pause)
        for robot in world.robots:
            yield _befall_robot(world, robot, pause)
            yield _befall_topics(world, robot, pause)
            if robot.exchanges or robot.errands:
                yield _befall_services(world, robot, pause)


async def _befall_robot(world: World, robot: Robot, pause: float) -> None:
    """One fault of a robot's after another, with a pause (s, on average) between them."""
    random = world.random(f"faults of {robot.name}")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(_ROBOT), tuple(_ROBOT.values()))
        await fault(world, robot, random)
        nights = world.climate.nights
        if nights and random.random() < nights / (1 - nights) * pause / _NIGHT:
            await night(world, robot, random)


async def _befall_server(world: World, pause: float) -> None:
    random = world.random("faults of the server")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(_SERVER), tuple(_SERVER.values()))
        await fault(world, random)


async def _befall_topics(world: World, robot: Robot, pause: float) -> None:
    random = world.random(f"faults of {robot.name}'s topics")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(_FLOW), tuple(_FLOW.values()))
        await fault(world, random.choice(robot.flows), random)


async def _befall_services(world: World, robot: Robot, pause: float) -> None:
    random = world.random(f"faults of {robot.name}'s services")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        (fault,) = random.choices(tuple(_EXCHANGE), tuple(_EXCHANGE.values()))
        called: list[Exchange | Errand] = [*robot.exchanges, *robot.errands]
        await fault(world, random.choice(called), random)


async def _set_clocks(world: World, pause: float) -> None:
    random = world.random("clocks")
    while True:
        await asyncio.sleep(random.expovariate(1 / pause))
        _set_clock(world, random.choice([world.server, *(robot.station for robot in world.robots)]), random)
