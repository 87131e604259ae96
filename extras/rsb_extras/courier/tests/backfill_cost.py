"""Prints what completing costs: ``python -m rsb_extras.courier.tests.backfill_cost [seeds]``.

It plays a robot on virtual time behind 2 Mbit/s with 30 % loss, which records three topics, and the other side, which
records what comes of them. The link is away for 60 s three times while they run, and twice while the rest is fetched.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
import time
from dataclasses import replace
from itertools import chain
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
from tests.simulation.conditions import STILL
from tests.simulation.ros import hash_of
from tests.simulation.world import World

from rsb_bridge.feature_api import LinkError
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_extras.courier.completed_recording import AskedCompletion, CompletedName
from rsb_extras.courier.completion_spool import CompletionSpool
from rsb_extras.courier.courier_records import Wanted
from rsb_extras.courier.fetch_spool import AskedFetch
from rsb_extras.courier.link_courier import LinkCourier
from rsb_extras.courier.live_parts import overlapping
from rsb_extras.courier.tests.courier_bed import robot_features
from rsb_extras.recording.mcap_file import new_recording, qos_profiles
from rsb_extras.recording.passing_messages import PassingMessages
from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.simulation.topic_flow import TopicFlow

    from rsb_bridge.feature_api import Link
    from rsb_extras.courier.completed_recording import CompletedRecording
    from rsb_extras.recording.message_ring import RingMessage

_BANDWIDTH, _LOSS = 250_000.0, 0.3  # bytes/s
_OUTAGE, _BETWEEN = 60.0, 40.0  # s
_TOPICS = (
    (Topic("/scan", "transmit", protocol="udp"), Qos(reliability="best_effort"), 1 / 10, 1500),
    (Topic("/odom", "transmit", protocol="tcp", max_age=2.0), Qos(), 1 / 20, 400),
    (Topic("/plan", "transmit", protocol="tcp"), Qos(depth=10), 1.0, 4000),
)
"""With the QoS of their publishers, s from one message to the next, and bytes of a message."""


class Backfill(NamedTuple):
    """What came of one world.

    Attributes:
        crossed: bytes of pieces, of which `heads` are of heads.
        seconds: on virtual time, and `took` on a real clock to compare and to write.
    """

    completed: CompletedRecording
    path: Path
    robot: Path
    crossed: int
    heads: int
    seconds: float
    took: float


def play(seed: int, folder: Path) -> Backfill:
    """Play a world, with its files in a folder that is there, in which nothing else is."""
    bags = folder / "bags"
    bags.mkdir()
    world = World(seed, replace(STILL, patience=60.0, outlive=5.0))
    (robot,) = world.robots
    robot.topic_flows.clear()
    world.topic_flows.clear()
    entries = tuple(entry for entry, *_ in _TOPICS)
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=entries, features=robot_features(bags))
    for entry, qos, period, size in _TOPICS:
        flow = world.add_topic_flow(robot, entry, world.random(entry.topic))
        flow.qos, flow.period, flow.size = qos, period, size
    found: list[Backfill] = []

    async def outage() -> None:
        with world.trouble("cut", robot):
            world.network.cut(robot.host.machine, world.server.machine)
            await asyncio.sleep(_OUTAGE)
            world.network.heal(robot.host.machine, world.server.machine)
            _spoil(world)

    async def live() -> None:
        await asyncio.sleep(20.0)
        _, there = world.link_ends(robot) or (None, None)
        assert there is not None
        published = [_published(flow) for flow in robot.topic_flows]
        came = _came(there)
        with world.trouble("loss", robot):
            _spoil(world)
            for _ in range(3):
                await asyncio.sleep(_BETWEEN)
                await outage()
            await asyncio.sleep(_BETWEEN)
            for flow in robot.topic_flows:
                flow.vanish()
            await asyncio.sleep(10.0)
            await asyncio.to_thread(_write, bags / "robot.mcap", chain(*published))
            await asyncio.to_thread(_write, folder / "live.mcap", map(_as_stored, came))
            found.append(await _completed(world, robot, folder, outage))

    world.play(life=live())
    return found[0]


def _spoil(world: World) -> None:
    (robot,) = world.robots
    for path in world.network.both_ways(robot.host.machine, world.server.machine):
        path.loss, path.bandwidth, path.latency = _LOSS, _BANDWIDTH, (0.02, 0.04)


def _channel(topic: str, type_name: str, qos: Qos) -> StoredChannel:
    return StoredChannel(topic, type_name, "cdr", qos_profiles(qos), ("", b""), hash_of(type_name), "")


def _published(flow: TopicFlow) -> list[StoredMessage]:
    """Return a list that gets all messages which a flow publishes, as a recorder on the robot writes them."""
    writer, channel = flow.writer, _channel(flow.near_name, flow.type_name, flow.qos)
    assert writer is not None
    messages: list[StoredMessage] = []
    random, plain = Random(flow.number), writer.publish
    # What no compression makes smaller, as padding of flows is zeros.
    writer.publish = lambda payload: plain(payload[:16] + random.randbytes(len(payload) - 16))  # type: ignore[method-assign]

    def publish(payload: bytes) -> None:
        now = flow.near.wall_ns()
        messages.append(StoredMessage(channel, now, now, writer.published, memoryview(payload)))

    writer.on_publish = publish
    return messages


def _came(link: Link) -> list[RingMessage]:
    """Return a list that gets all messages which come over a link, as `record` keeps them."""
    messages: list[RingMessage] = []
    link.context.shared(PassingMessages).give(messages.append)
    for route in link.routes.values():
        half: Any = route.half
        if hasattr(half, "flow"):
            half.flow.renew_tap()
    return messages


def _as_stored(message: RingMessage) -> StoredMessage:
    topic = message.topic
    channel = _channel(topic.topic, topic.type_name, topic.qos)
    return StoredMessage(channel, message.time, message.published, message.number, memoryview(message.content))


def _write(path: Path, messages: Iterable[StoredMessage]) -> None:
    with new_recording(path) as recording:
        for each in sorted(messages, key=lambda each: each.time):
            recording.copy(each)


async def _completed(world: World, robot: Any, folder: Path, outage: Any) -> Backfill:
    _, there = world.link_ends(robot) or (None, None)
    assert there is not None
    (listed,) = await _asked(there)
    far = {route.far_topic: route.local_topic for route in there.routes.values() if route.purpose.is_shown}
    names = tuple(CompletedName(each.name, far[each.name]) for each in listed.topics)
    wanted = Wanted(listed.id, listed.stamp, tuple(each.there for each in names), listed.begin, listed.end, heads=True)
    completes = AskedCompletion(names, listed.begin, listed.end, ahead=there.clock.offset)
    asked = AskedFetch("completed", "", "", listed, wanted, "", completes)
    parts = overlapping([folder / "live.mcap"], [each.here for each in names], 0, 1 << 62)
    spool = CompletionSpool(folder / ".completed.fetch", asked, parts).make()
    began, took, outages = world.loop.time(), 0.0, 2
    try:
        while True:
            now = time.perf_counter()
            row = spool.next_row(lambda: False)
            took += time.perf_counter() - now
            if row is None:
                break
            getting = asyncio.ensure_future(_row(world, robot, row))
            while not getting.done():
                if outages and spool.share > 0.5 / outages:
                    outages -= 1
                    await outage()
                await asyncio.sleep(0.05)
            await getting
        crossed, heads, seconds = spool.taken, spool.rows[0].taken, world.loop.time() - began
        now = time.perf_counter()
        spool.write(lambda: False)
        took += time.perf_counter() - now
        assert spool.completed is not None
        return Backfill(spool.completed, spool.path, folder / "bags" / "robot.mcap", crossed, heads, seconds, took)
    finally:
        spool.remove()


async def _asked(link: Link) -> Any:
    while True:
        try:
            return await link.extensions.find(LinkCourier).recordings()
        except LinkError:
            await asyncio.sleep(1.0)


async def _row(world: World, robot: Any, row: Any) -> None:
    """Get a row of pieces as `CourierPart` does, however often the link is lost."""
    while not row.is_whole:
        _, there = world.link_ends(robot) or (None, None)
        try:
            if there is not None:
                await there.extensions.find(LinkCourier).receive(row)
        except LinkError:
            pass
        await asyncio.sleep(1.0)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rsb_extras.courier.tests.backfill_cost", description=__doc__)
    parser.add_argument("seeds", nargs="?", type=int, default=3)
    arguments = parser.parse_args()
    os.environ.pop("STATE_DIRECTORY", None)
    for seed in range(1, arguments.seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            os.environ["XDG_STATE_HOME"] = folder
            one = play(seed, Path(folder))
            print(_line(seed, one), flush=True)
            for each in one.completed.topics:
                print(f"  {each.name}: {each.live} live, {each.fetched} fetched, {each.missing} missing", flush=True)


def _line(seed: int, one: Backfill) -> str:
    result, clock = one.completed, one.completed.clock
    size = one.robot.stat().st_size
    return (
        f"seed {seed}: {one.crossed:,} bytes of pieces, {one.heads:,} of them heads, in {one.seconds:.0f} s, where the"
        f" whole file has {size:,}; {result.fetched:,} of {result.whole:,} bytes of messages fetched; clock by"
        f" {clock.matched:,} messages within {clock.spread / 1e6:.1f} ms; {one.took:.1f} s to compare and write"
    )


if __name__ == "__main__":
    main()
