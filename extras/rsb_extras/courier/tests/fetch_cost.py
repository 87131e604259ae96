"""Prints what a fetch does to a topic beside it, and what cuts cost a fetch.

``python -m rsb_extras.courier.tests.fetch_cost beside [MB] [LINE]`` plays a robot behind 1 Mbit/s on virtual time,
with a topic of 20 Hz, without a fetch and with one; ``… outages [MB] [LINE]`` one behind 20 Mbit/s and 20 ms, whose
fetch has 20 outages of 3 s. Both play the Wi-Fi or the tunnel of `bench.robot_links`, too, and a line whose delay
varies by itself. ``… cuts [MB]`` has two engines of this machine get a recording through a relay of 20 Mbit/s, with
20 cuts.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import msgspec
from tests.simulation.conditions import STILL
from tests.simulation.network import Path as NetworkPath
from tests.simulation.world import World
from tests.support.ports import free_port
from tests.support.relay import Relay

from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.feature import MAY
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic, session_keys
from rsb_extras.courier import RECORDINGS_KEY, RecordingFolders
from rsb_extras.courier.courier_records import Wanted
from rsb_extras.courier.courier_requests import FetchRecording, FetchReport, FetchState, ListFetches, ListRecordings
from rsb_extras.courier.fetch_spool import AskedFetch, FetchSpool
from rsb_extras.courier.link_courier import LinkCourier
from rsb_extras.courier.slices import SliceJoiner
from rsb_extras.courier.tests.bags import messages
from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.open_recording import OpenRecording

if TYPE_CHECKING:
    from random import Random

    from rsb_bridge.feature_api import Link

_MBIT = 125_000.0  # bytes/s


class Line(NamedTuple):
    """What carries a fetch on virtual time: s of latency, bytes/s, and the part that is lost and sent again."""

    latency: tuple[float, float]
    bandwidth: float
    loss: float = 0.0


LINES = {
    "line": Line((0.02, 0.021), 20 * _MBIT),
    "wifi": Line((0.02, 0.035), 20 * _MBIT, 0.02),
    "jitter": Line((0.02, 0.22), 20 * _MBIT),
    "tunnel": Line((0.005, 0.0051), 5_000.0),
}
_SETTLED, _SECONDS = 60.0, 120.0
_CUTS, _OUTAGE = 20, 3.0
_DOMAINS = 66, 67


def _robot_features(folder: Path) -> dict[str, Any]:
    given = session_keys()[MAY].type(recordings=True)
    return {RECORDINGS_KEY.name: RecordingFolders((str(folder),)), MAY: given}


def _write(path: Path, megabytes: int) -> None:
    with new_recording(path) as recording:
        for message in messages(megabytes * 5, 5000):
            recording.copy(message)


class Beside(NamedTuple):
    """A topic in `_SECONDS` s: Hz, ages (s), and bytes/s of a fetch."""

    rate: float
    p50: float
    p99: float
    fetched: float


def topic_beside(seed: int, size: int, bags: Path, *, fetches: bool, line: Line | None = None) -> Beside:
    """Play a robot with a topic of 20 Hz behind 1 Mbit/s, or a line."""
    world = World(seed, replace(STILL, patience=4.0))
    (robot,) = world.robots
    robot.topic_flows.clear()
    world.topic_flows.clear()
    entry = Topic(topic="/odom", direction="transmit")
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=(entry,), features=_robot_features(bags))
    flow = world.add_topic_flow(robot, entry, world.random("flows"))
    flow.qos, flow.period, flow.size = Qos(reliability="best_effort"), 1 / 20, size
    found, slices, add = list[Beside](), list[int](), SliceJoiner.add

    def counted(joiner: SliceJoiner, number: int, offset: int, whole: int, part: bytes) -> bytes | None:
        slices.append(len(part))
        return add(joiner, number, offset, whole, part)

    async def live() -> None:
        await asyncio.sleep(20.0)
        machines = robot.host.machine, world.server.machine
        if line is None:
            world.network.path(*machines).bandwidth = _MBIT
        else:
            for each in world.network.both_ways(*machines):
                each.latency, each.bandwidth, each.loss = line
        here, there = world.link_ends(robot) or (None, None)
        assert here is not None
        assert there is not None
        getting = None
        if fetches:
            spool = await _spool(there)
            getting = asyncio.ensure_future(there.extensions.find(LinkCourier).receive(spool.row))
        await asyncio.sleep(_SETTLED)
        heard, before = flow.heard, sum(slices)
        await asyncio.sleep(_SECONDS)
        shown = next(each for each in here.routes.values() if each.local_topic.endswith("/odom")).snapshot()
        got = (sum(slices) - before) / _SECONDS
        rate = (flow.heard - heard) / _SECONDS
        found.append(Beside(rate, shown.latency_p50 or 0.0, shown.latency_p99 or 0.0, got))
        if getting is not None:
            assert not getting.done(), getting.exception()
            getting.cancel()

    with patch.object(SliceJoiner, "add", counted):
        world.play(life=live())
    return found[0]


async def _spool(link: Link) -> FetchSpool:
    (listed,) = await link.extensions.find(LinkCourier).recordings()
    wanted = Wanted(listed.id, listed.stamp, tuple(each.name for each in listed.topics))
    folder = Path(tempfile.mkdtemp()) / ".beside.fetch"
    return FetchSpool(folder, AskedFetch("beside", "", "", listed, wanted)).make()


def beside(folder: Path, megabytes: int, line: Line | None) -> None:
    _write(folder / "drive.mcap", megabytes)
    for size in (60,) if line is LINES["tunnel"] else (1_000, 4_000):
        for fetches in (False, True):
            for seed in (1, 2, 3):
                one = topic_beside(seed, size, folder, fetches=fetches, line=line)
                what = f"beside a fetch of {one.fetched / 1000:.1f} kB/s" if fetches else "alone"
                ages = f"p50 {one.p50 * 1000:.0f} ms, p99 {one.p99 * 1000:.0f} ms"
                print(f"20 Hz of {size:,} B, seed {seed}, {what}: {one.rate:.1f} Hz, {ages}", flush=True)


def outages(folder: Path, megabytes: int, line: Line) -> None:
    """Play a robot behind a line, of which another machine gets a recording."""
    _write(folder / "drive.mcap", megabytes)
    for count in (0, _CUTS):
        world = World(1, replace(STILL, patience=60.0, outlive=600.0))
        (robot,) = world.robots
        robot.topic_flows.clear()
        world.topic_flows.clear()
        session = robot.host.session
        robot.host.session = msgspec.structs.replace(session, topics=(), features=_robot_features(folder))
        seconds, carried, taken = world_fetch(world, count, line)
        limit = carried / line.bandwidth + count * _OUTAGE
        print(
            f"{taken:,} bytes of pieces with {count} outages of {_OUTAGE:g} s: {carried:,} on the line "
            f"({carried / taken - 1:.2%} more), {seconds:.1f} s; the line needs {limit:.1f} s",
            flush=True,
        )


def world_fetch(world: World, count: int, line: Line = LINES["line"]) -> tuple[float, int, int]:
    """Return the s of a fetch, and the bytes on the line and in its pieces."""
    (robot,) = world.robots
    found: list[tuple[float, int, int]] = []
    carried = 0
    delay = NetworkPath.delay

    async def live() -> None:
        nonlocal carried
        await asyncio.sleep(20.0)
        path = world.network.path(robot.host.machine, world.server.machine)
        for each in world.network.both_ways(robot.host.machine, world.server.machine):
            each.latency, each.bandwidth, each.loss = line
        _, there = world.link_ends(robot) or (None, None)
        assert there is not None
        spool = await _spool(there)
        began, whole = world.loop.time(), spool.asked.listed.end - spool.asked.listed.begin

        def counted(self: NetworkPath, size: int, now: float, random: Random) -> float:
            nonlocal carried
            carried += size if self is path else 0
            return delay(self, size, now, random)

        NetworkPath.delay = counted  # type: ignore[method-assign]
        marks = [spool.asked.listed.begin + whole * (at + 1) // (count + 1) for at in range(count)]
        getting = asyncio.ensure_future(there.extensions.find(LinkCourier).receive(spool.row))
        while not getting.done():
            if marks and spool.row.at.time > marks[0]:
                marks.pop(0)
                with world.trouble("cut", robot):
                    world.network.cut(robot.host.machine, world.server.machine)
                    await asyncio.sleep(_OUTAGE)
                    world.network.heal(robot.host.machine, world.server.machine)
            await asyncio.sleep(0.05)
        await getting
        assert not marks
        found.append((world.loop.time() - began, carried, spool.taken))

    try:
        world.play(life=live())
    finally:
        NetworkPath.delay = delay  # type: ignore[method-assign]
    return found[0]


class Fetched(NamedTuple):
    """Bytes of the file's messages as they crossed and as the relay carried them, and s."""

    pieces: int
    carried: int
    seconds: float


def _fetched(folder: Path, bag: Path, number: int, cuts: int) -> Fetched:
    os.environ["XDG_STATE_HOME"] = str(folder / f"state{number}")
    port = free_port()
    common: dict[str, Any] = {"name": "robot1", "key_file": "robot1.key"}
    pc = Session(role="server", server_ip="127.0.0.1", server_port=port, domain_id=_DOMAINS[1], **common)
    with Relay(("127.0.0.1", port), rate=20 * _MBIT) as relay:
        robot = Session(
            role="client", server_ip=relay.host, server_port=relay.port, domain_id=_DOMAINS[0],
            features=_robot_features(bag.parent), **common,
        )  # fmt: skip
        engines = [Engine(each, base=folder) for each in (pc, robot)]
        for engine in engines:
            engine.start()
        try:
            return _get(engines[0], bag, relay, cuts)
        finally:
            for engine in reversed(engines):
                engine.stop()


def _get(engine: Engine, bag: Path, relay: Relay, cuts: int) -> Fetched:
    while not any(group.recordings for group in engine.do(ListRecordings()).result(60) if group.link):
        time.sleep(0.1)
    before, began = relay.carried, time.monotonic()
    name = engine.do(FetchRecording("robot1", bag.name)).result(60)
    # A cut at each of so many equal parts of the recording.
    marks = [(at + 1) / (cuts + 1) for at in range(cuts)]
    while (now := _report(engine, name)).state not in (FetchState.DONE, FetchState.FAILED):
        if marks and now.share > marks[0]:
            marks.pop(0)
            relay.cut()
        time.sleep(0.05)
    assert now.state is FetchState.DONE, now
    assert not marks
    seconds, carried = time.monotonic() - began, relay.carried - before
    assert _digest(Path(now.path)) == _digest(bag)
    return Fetched(now.taken, carried, seconds)


def _report(engine: Engine, name: str) -> FetchReport:
    return next(each for each in engine.do(ListFetches()).result(60) if each.name == name)


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    for each in OpenRecording(path).messages():
        digest.update(repr((each.channel, each.time, each.published, each.number)).encode())
        digest.update(each.content)
    return digest.hexdigest()


def cuts(folder: Path, megabytes: int) -> None:
    bag = folder / "bags" / "drive.mcap"
    bag.parent.mkdir()
    write_key(folder / "robot1.key")
    _write(bag, megabytes)
    size = bag.stat().st_size
    for number, count in enumerate((0, _CUTS)):
        one = _fetched(folder, bag, number, count)
        limit = one.carried / (20 * _MBIT)
        print(
            f"{size / 1e6:.0f} MB with {count} cuts: {one.pieces:,} bytes of pieces, {one.carried:,} carried "
            f"({one.carried / one.pieces - 1:.2%} more), {one.seconds:.1f} s; at 20 Mbit/s these take {limit:.1f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rsb_extras.courier.tests.fetch_cost", description=__doc__)
    parser.add_argument("what", choices=("beside", "outages", "cuts"))
    parser.add_argument("megabytes", nargs="?", type=int, default=200)
    parser.add_argument("line", nargs="?", choices=LINES)
    arguments = parser.parse_args()
    os.environ.pop("STATE_DIRECTORY", None)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        if arguments.what == "beside":
            beside(Path(folder), arguments.megabytes, LINES.get(arguments.line))
        elif arguments.what == "outages":
            outages(Path(folder), arguments.megabytes, LINES[arguments.line or "line"])
        else:
            cuts(Path(folder), arguments.megabytes)


if __name__ == "__main__":
    main()
