"""The engine over RFCOMM. ROS does not fit in the machine: its side is `stand_in.StandIn`, at the engine's own seam."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from rsb_bridge.bluetooth.scan import held_channels
from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, State

from .conftest import bare_rate, wait_until
from .stand_in import StandIn

_CHANNEL = 10


@pytest.fixture(autouse=True, scope="module")
def unpaired() -> None:
    """The virtual controllers can't authenticate a second time after a link is down, so they don't pair at all."""
    for adapter in ("hci0", "hci1"):
        subprocess.run(["hciconfig", adapter, "sspmode", "0"], check=True)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """A folder with the key of both sides, and another."""
    write_key(tmp_path / "robot.key")
    write_key(tmp_path / "other.key")
    return tmp_path


def session(role: str, address: str, *topics: Topic, key: str = "robot.key") -> Session:
    return Session(
        name="robot1",
        role="server" if role == "server" else "client",
        server_ip=address,
        server_port=_CHANNEL,
        domain_id=1,
        key_file=key,
        shutdown_topic=None,
        topics=topics,
    )


@contextmanager
def running(session: Session, base: Path, ros: StandIn) -> Iterator[Engine]:
    engine = Engine(session, base=base, ros=ros)
    engine.start()
    try:
        yield engine
    finally:
        engine.stop()


def link(engine: Engine) -> LinkSnapshot:
    return engine.snapshot().links[0]


def route(engine: Engine, topic: str) -> RouteSnapshot:
    return next(route for route in engine.snapshot().routes if route.topic == topic)


def linked(engine: Engine) -> bool:
    return link(engine).state is State.OK


def test_a_large_message_each_way_encrypted(addresses: tuple[str, str], base: Path) -> None:
    topics = (Topic("/there", "transmit"), Topic("/back", "receive"))
    client_side, server_side = StandIn(there=Qos()), StandIn(back=Qos())
    there, back = os.urandom(300_000), os.urandom(300_000)
    with (
        running(session("server", addresses[0]), base, server_side) as server,
        running(session("client", addresses[0], *topics), base, client_side) as client,
    ):
        wait_until(lambda: client_side.subscribed("/there") and server_side.subscribed("/back"), "both topics open")
        for engine, peer in ((client, addresses[0]), (server, addresses[1])):
            wait_until(partial(linked, engine), "the snapshot has it")
            assert link(engine).encrypted
            assert link(engine).cipher in {"AESGCM", "CHACHAPOLY"}
            assert link(engine).peer == f"{peer} channel {_CHANNEL}"
        client_side.publish("/there", there)
        server_side.publish("/back", back)
        wait_until(lambda: client_side.arrived["/back"] and server_side.arrived["/there"], "both arrived")
        wait_until(lambda: route(client, "/there").ledger.delivered == 1, "the ledger is settled")
        assert route(client, "/there").transport == "bluetooth"
        assert route(client, "/there").port == _CHANNEL
    assert server_side.arrived["/there"][0].payload == there
    assert client_side.arrived["/back"][0].payload == back


def test_throughput_beside_a_bare_socket(addresses: tuple[str, str], base: Path) -> None:
    """The whole bridge, sealed and in chunks, both sides in this one process and on one emulated CPU."""
    count, size = 5, 100_000
    client_side, server_side = StandIn(map=Qos(depth=count)), StandIn()
    topics = [Topic("/map", "transmit", qos=count, compression="none")]
    with (
        running(session("server", addresses[0]), base, server_side),
        running(session("client", addresses[0], *topics), base, client_side),
    ):
        wait_until(lambda: client_side.subscribed("/map"), "open")
        started = time.monotonic()
        for _ in range(count):
            client_side.publish("/map", bytes(size))
        _let_arrive(server_side, "/map", count)
        by_bridge = count * size / (server_side.arrived["/map"][-1].time - started)
    by_socket = bare_rate(addresses[0])
    sys.stdout.write(f"bridge: {by_bridge / 1e3:.0f} kB/s, a bare socket {by_socket / 1e3:.0f} kB/s\n")
    assert by_bridge > 0.1 * by_socket


def test_calls_beside_maps(addresses: tuple[str, str], base: Path) -> None:
    """A service of the robot's is called from the other side, over the channel that maps fill."""
    client_side, server_side = StandIn(map=Qos(depth=5)), StandIn()
    client_side.answering["/dock"] = lambda request: request[::-1]
    topics = [Topic("/map", "transmit", compression="none"), Topic("/dock", "receive", kind="service")]
    with (
        running(session("server", addresses[0]), base, server_side) as server,
        running(session("client", addresses[0], *topics), base, client_side) as client,
    ):
        wait_until(lambda: client_side.subscribed("/map") and server_side.serves("/dock"), "both open")
        for _ in range(3):
            client_side.publish("/map", bytes(100_000))
        for request in (b"now", os.urandom(50_000)):
            assert server_side.call("/dock", request, 60.0) == request[::-1]
        for engine in (server, client):
            wait_until(partial(_answered, engine, 2), "both sides count them")
            assert route(engine, "/dock").transport == "bluetooth"


def _answered(engine: Engine, count: int) -> bool:
    found = next((route.calls for route in engine.snapshot().routes if route.topic == "/dock"), None)
    return found is not None and (found.asked, found.answered) == (count, count)


def test_a_joystick_beside_maps(addresses: tuple[str, str], base: Path) -> None:
    """Eight topics; maps fill the link all the time, and the 10 Hz topic waits for a chunk or two, never for a map."""
    sizes = {"map": 100_000, "costmap": 100_000, "cloud": 30_000, "scan": 6_000, "odom": 700, "imu": 320, "pose": 80}
    client_side = StandIn(joy=Qos(), **dict.fromkeys(sizes, Qos(depth=1)))
    topics = [Topic(topic, "transmit", compression="none") for topic in client_side.offered]
    server_side = StandIn()
    with (
        running(session("server", addresses[0]), base, server_side),
        running(session("client", addresses[0], *topics), base, client_side) as client,
    ):
        wait_until(lambda: client_side.subscribed(*client_side.offered), "all topics open")
        client_side.publish_at(10, "/joy", lambda _: struct.pack("d", time.monotonic()))
        _let_arrive(server_side, "/joy", 20)
        alone = _latencies(server_side)
        for name, size in sizes.items():
            client_side.publish_at(50, f"/{name}", partial(_message, size))
        wait_until(lambda: route(client, "/map").ledger.dropped.get("queue full", 0) > 5, "the link is full")
        server_side.arrived["/joy"].clear()
        server_side.arrived["/map"].clear()
        _let_arrive(server_side, "/joy", 30)
        beside, arrived = _latencies(server_side), server_side.arrived["/joy"][:30]
        maps = [each.time for each in server_side.arrived["/map"]]
        assert all(len(server_side.arrived[f"/{name}"]) > 1 for name in sizes)
    a_map = (maps[-1] - maps[0]) / (len(maps) - 1)
    rate = 29 / (arrived[-1].time - arrived[0].time)
    said = [struct.unpack("d", each.payload)[0] for each in arrived]
    published = 29 / (said[-1] - said[0])  # a guest with one slow processor does not keep to 10 Hz
    sys.stdout.write(
        f"joystick: median {1e3 * alone[len(alone) // 2]:.1f} ms alone, {1e3 * beside[len(beside) // 2]:.1f} ms beside "
        f"maps, at most {1e3 * beside[-1]:.1f} ms; {rate:.2f} of {published:.2f} Hz; a map takes {1e3 * a_map:.0f} ms\n"
    )
    assert rate > 0.95 * published
    assert max(later - earlier for earlier, later in pairwise(said)) < 2 / published  # none was dropped
    assert beside[len(beside) // 2] < a_map / 4
    assert beside[-1] < a_map


def _message(size: int, _: int) -> bytes:
    return bytes(size)


def _let_arrive(side: StandIn, topic: str, count: int) -> None:
    wait_until(lambda: len(side.arrived[topic]) >= count, f"{count} on {topic}", 20.0)


def _latencies(side: StandIn) -> list[float]:
    return sorted(one.time - struct.unpack("d", one.payload)[0] for one in side.arrived["/joy"])


def test_a_wrong_key_is_refused_in_words(addresses: tuple[str, str], base: Path) -> None:
    with (
        running(session("server", addresses[0]), base, StandIn()) as server,
        running(session("client", addresses[0], key="other.key"), base, StandIn()) as client,
    ):
        wait_until(lambda: " differ: " in link(client).reason, "the client says why")
        assert any(event.code == EventCode.LINK_WRONG_KEY and addresses[1] in event.text for event in server.events())
        assert not linked(server)


def test_a_topic_over_bluetooth_on_an_ip_link(addresses: tuple[str, str], base: Path) -> None:
    client_side, server_side = StandIn(scan=Qos(), odom=Qos()), StandIn()
    topics = (Topic("/scan", "transmit", protocol="bluetooth", port=11), Topic("/odom", "transmit"))
    common = {"server_port": 49152, "bluetooth_address": addresses[0]}
    with (
        running(structs.replace(session("server", "127.0.0.1"), **common), base, server_side),
        running(structs.replace(session("client", "127.0.0.1", *topics), **common), base, client_side) as client,
    ):
        wait_until(lambda: client_side.subscribed("/scan") and client_side.subscribed("/odom"), "both open")
        client_side.publish("/scan", b"1" * 10_000)
        client_side.publish("/odom", b"2" * 1_000)
        _let_arrive(server_side, "/scan", 1)
        _let_arrive(server_side, "/odom", 1)
        assert (route(client, "/scan").transport, route(client, "/scan").port) == ("bluetooth", 11)
        assert (route(client, "/odom").transport, route(client, "/odom").port) == ("tcp", 49152)


_SIZES = {"/map": 100_000, "/joy": 80, "/cmd": 5_000, "/odom": 700}


def _all_cross(client_side: StandIn, server_side: StandIn) -> None:
    """Messages of `_SIZES` at once, each topic's whole and in order; /cmd goes to the client."""
    wait_until(lambda: client_side.subscribed("/map", "/joy", "/odom"), "the client's are open", 20.0)
    wait_until(lambda: server_side.subscribed("/cmd"), "the server's is open", 20.0)
    ways = dict.fromkeys(_SIZES, (client_side, server_side)) | {"/cmd": (server_side, client_side)}
    for topic, (source, sink) in ways.items():
        sink.arrived[topic].clear()
        for number in range(5):
            source.publish(topic, bytes([number]) * _SIZES[topic])
    for topic, (_, sink) in ways.items():
        wait_until(lambda topic=topic, sink=sink: len(_whole(sink, topic)) >= 5, f"five on {topic}", 20.0)
        assert _whole(sink, topic) == [bytes([n]) * _SIZES[topic] for n in range(5)]


def _whole(sink: StandIn, topic: str) -> list[bytes]:
    """Return the messages that arrived, without `_all_flow`'s empty ones."""
    return [one.payload for one in sink.arrived[topic] if one.payload]


def _all_flow(client_side: StandIn, server_side: StandIn) -> None:
    """Wait until every topic flows again; messages from the time of the break may be lost."""
    ways = dict.fromkeys(_SIZES, (client_side, server_side)) | {"/cmd": (server_side, client_side)}
    for topic, (_, sink) in ways.items():
        sink.arrived[topic].clear()

    def came() -> bool:
        for topic, (source, _) in ways.items():
            source.publish(topic, b"")
        time.sleep(0.1)
        return all(sink.arrived[topic] for topic, (_, sink) in ways.items())

    wait_until(came, "all flow", 30.0)


def test_topics_share_a_channel_beside_an_ip_link(addresses: tuple[str, str], base: Path) -> None:
    """Also after one was replaced, and after the radio link broke. The kernel has one connection on a channel."""
    client_side, server_side = StandIn(map=Qos(), joy=Qos(), odom=Qos()), StandIn(cmd=Qos())
    radio: dict[str, Any] = {"protocol": "bluetooth", "port": 11, "compression": "none"}
    on_radio = [
        Topic("/map", "transmit", **radio),
        Topic("/joy", "transmit", **radio),
        Topic("/cmd", "receive", **radio),
    ]
    common = {"server_port": 49152, "bluetooth_address": addresses[0]}
    listening = structs.replace(session("server", "127.0.0.1"), **common)
    calling = structs.replace(session("client", "127.0.0.1", *on_radio, Topic("/odom", "transmit")), **common)
    with running(listening, base, server_side) as server, running(calling, base, client_side) as client:
        _all_cross(client_side, server_side)
        wait_until(lambda: held_channels(listening, server.snapshot()) == {(addresses[0], 11)}, "the snapshot has it")
        client.remove_topic("robot1 → /map").result(60)
        client.add_topic(on_radio[0]).result(60)
        _all_cross(client_side, server_side)
        before = link(client).since
        subprocess.run(_DISCONNECT[0].format(server=addresses[0]).split(), check=True)
        wait_until(
            lambda: any(event.code == EventCode.LINK_STREAM_REOPENED for event in client.events()), "it is noticed"
        )
        _all_flow(client_side, server_side)
        _all_cross(client_side, server_side)
        assert link(client).since == before


_SERVERS = """
import os, signal, sys
from pathlib import Path
from rsb_bridge.engine import Engine
from rsb_bridge.model.qos import Qos
from tests.bluetooth.guest.stand_in import StandIn
from tests.bluetooth.guest.test_bridge import session

def serve(address, base):
    ros = StandIn(odom=Qos())
    ros.publish_at(20, "/odom", lambda number: number.to_bytes(8, "little"))
    Engine(session("server", address), base=Path(base), ros=ros).start()
    print(os.getpid(), flush=True)
    signal.pause()

signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no zombies
for line in sys.stdin:
    if not os.fork():
        serve(*line.split())
"""


@pytest.fixture(scope="module")
def servers() -> Iterator[subprocess.Popen[str]]:
    """Forks servers: to start a Python and import the engine takes seconds in here."""
    command = [sys.executable, "-c", _SERVERS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as forker:
        yield forker


@contextmanager
def server_process(servers: subprocess.Popen[str], address: str, base: Path) -> Iterator[None]:
    """A server of its own process, killed at the end."""
    assert servers.stdin is not None
    assert servers.stdout is not None
    servers.stdin.write(f"{address} {base}\n")
    servers.stdin.flush()
    pid = int(servers.stdout.readline())
    try:
        yield
    finally:
        os.kill(pid, signal.SIGKILL)


def test_a_killed_peer_comes_back(servers: subprocess.Popen[str], addresses: tuple[str, str], base: Path) -> None:
    client_side = StandIn()
    with running(session("client", addresses[0], Topic("/odom", "receive")), base, client_side) as client:
        for _ in range(2):
            with server_process(servers, addresses[0], base):
                _let_arrive(client_side, "/odom", 5)
            wait_until(lambda: not linked(client), "the client notices")
            client_side.arrived["/odom"].clear()


_DISCONNECT = ["hcitool -i hci1 dc {server}"]
_OFF_AND_ON = [f"hciconfig hci{number} {what}" for what in ("down", "up", "piscan", "sspmode 0") for number in (0, 1)]


@pytest.mark.parametrize("commands", [_DISCONNECT, _OFF_AND_ON], ids=["disconnected", "off and on"])
def test_a_broken_radio_link_comes_back(
    commands: list[str], servers: subprocess.Popen[str], addresses: tuple[str, str], base: Path
) -> None:
    """The virtual radio has no supervision timeout, so both ends are disconnected, or both switched off."""
    client_side = StandIn()
    with (
        server_process(servers, addresses[0], base),
        running(session("client", addresses[0], Topic("/odom", "receive")), base, client_side) as client,
    ):
        _let_arrive(client_side, "/odom", 5)
        before = link(client).since
        for command in commands:
            subprocess.run(command.format(server=addresses[0]).split(), check=True)
        wait_until(lambda: link(client).since != before, "the client notices")
        client_side.arrived["/odom"].clear()
        _let_arrive(client_side, "/odom", 5)
