"""A process with few file descriptors: topics that get none report it, and nothing else suffers."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import resource
import socket
import time
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.acceptors import Accepting
from tests.support.bridge import happened, linked, now, route
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.long import long
from tests.support.ports import free_port, free_ports
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.link.connecting import Failure
from rsb_bridge.link.topic_ports import PortDenied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.transport.descriptors import MORE_DESCRIPTORS, Scarcity
from rsb_bridge.transport.streams import Stream, StreamHandler, StreamProblem
from rsb_bridge.transport.tcp import Tcp

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs

    from rsb_bridge.link.client_channels import ClientChannels
    from rsb_bridge.transport.transport import StreamTransport

TOPICS = 100
PORTS = 40
"""Of topics: each takes two descriptors of a client, and three of a server."""


@contextlib.contextmanager
def none_left() -> Iterator[None]:
    """Take all descriptors that there are up to a low limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(path.name) for path in Path("/proc/self/fd").iterdir())
    taken: list[int] = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 2, hard))
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.dup(0))
        yield
    finally:
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_connections_that_cannot_be_accepted_wait() -> None:
    """The loop learns of it once, not once for each connection that the kernel holds, and does other work."""
    connected: list[Stream] = []
    shortages: list[str] = []

    class Handler(StreamHandler):
        def connected(self, stream: Stream) -> None:
            connected.append(stream)

    async def play() -> None:
        port = free_port()
        listener = await Tcp().listen("127.0.0.1", port, Accepting(Handler, shortage=shortages.append))
        with contextlib.ExitStack() as clients:
            waiting = [clients.enter_context(socket.socket()) for _ in range(3)]
            with none_left():
                began = time.monotonic()
                for client in waiting:
                    client.connect(("127.0.0.1", port))
                await until(lambda: shortages)
                for _ in range(100):
                    await asyncio.sleep(0)
                # It tries again four times a second, and this thread may stand still for longer.
                assert len(shortages) <= 1 + 4 * (time.monotonic() - began)
                assert connected == []
            await until(lambda: len(connected) == len(waiting))
            for stream in connected:
                stream.abort("done")
            await until(lambda: all(stream.gone for stream in connected))
        listener.close()

    asyncio.run(play())
    assert shortages[0] == StreamProblem.NO_DESCRIPTORS(error=os.strerror(errno.EMFILE), remedy=MORE_DESCRIPTORS)


async def until(condition: Callable[[], object], within: float = 180.0) -> None:
    """Wait for a condition, like `eventually`, while the loop runs."""
    async with asyncio.timeout(within):
        while True:
            if condition():
                return
            await asyncio.sleep(0)


def test_the_program_takes_all_that_it_may_have(bridge: Bridge, programs: Programs) -> None:
    """The soft limit is 1,024 on most systems, for programs that can do with no more."""
    program = programs.start(bridge.server_session(), descriptors=(256, 4096))
    program.wait_for("listening")
    assert resource.prlimit(program.pid, resource.RLIMIT_NOFILE) == (4096, 4096)


@pytest.mark.parametrize("side", ["server", *long("client")])
def test_topics_beyond_the_limit(side: str, bridge: Bridge, programs: Programs) -> None:
    """Both sides show whose limit it is; the link, the other topics and other clients are served.

    Topics with ports of their own take descriptors; all others share two streams.
    """
    bridge.make_key("other")
    clients = (Client("robot1"), Client("robot2", key_file="other.key"))
    ports = free_ports(PORTS)
    topics = (Topic(f"/topic{port}", "transmit", type="std_msgs/msg/String", qos=1, port=port) for port in ports)
    sessions = {
        "server": bridge.server_session(name="pc", clients=clients, ports=ports),
        "client": bridge.client_session(*topics),
    }
    short = programs.start(sessions.pop(side), descriptors=(100, 150))
    ((_, session),) = sessions.items()
    short.wait_for("listening" if side == "server" else "connecting")
    other = bridge.start(session)
    message = {
        "client": Scarcity.ROUTE_WITHOUT_STREAM(side="client", limit=150, remedy=MORE_DESCRIPTORS),
        "server": PortDenied.TOO_MANY_DESCRIPTORS(client="robot1", limit=150, remedy=MORE_DESCRIPTORS),
    }[side]
    eventually(lambda: happened(other, EventCode.ROUTE_CONNECTED) and message in "".join(short.said))
    refused = eventually(lambda: [route for route in now(other).routes if message in route.reason])
    assert len(refused) < len(ports)
    assert any(route.state != "down" for route in now(other).routes)
    assert not happened(other, EventCode.LINK_LOST)
    if side == "server":
        newcomer = bridge.client(name="robot2", key_file="other.key")
        eventually(lambda: linked(newcomer, "robot2"))


def test_greedy_client_leaves_enough_for_next(bridge: Bridge, programs: Programs, robot: Domain, pc: Domain) -> None:
    """The limit cannot be raised. Strangers connect meanwhile; another client and an operator still get in."""
    bridge.make_key("other")
    clients = (Client("robot1", key_file=bridge.key_file), Client("robot2", key_file="other.key"))
    server = programs.start(bridge.server_session(name="pc", clients=clients), descriptors=(256, 256))
    server.wait_for("listening")
    names = [f"/served{number}" for number in range(5)]
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    with contextlib.ExitStack() as resources:
        hog = resources.enter_context(Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret))
        hog.route("/hogged", "tcp", Qos())
        assert hog.has_streams()
        for number in range(TOPICS):
            hog.route(f"/hogged{number}", "tcp", Qos())
            assert hog.open_stream(large=bool(number % 2))  # it replaces one of the two shared streams
        for _ in range(TOPICS):
            resources.enter_context(socket.create_connection(("127.0.0.1", bridge.port)))
        client = bridge.client(*(Topic(name, "transmit") for name in names), name="robot2", key_file="other.key")
        eventually(lambda: all(out.get_subscription_count() for out in outs))
        for out, there in zip(outs, theres, strict=True):
            eventually(lambda out=out, there=there: out.publish(text("served")) or there.payloads)
        operator = RemoteEngine(bridge.folder / "server0.yaml.sock")
        resources.callback(operator.stop)
        operator.start()
        eventually(lambda: {link.name for link in operator.snapshot().links if link.state == "ok"} >= {"robot2"})
    assert not happened(client, EventCode.LINK_LOST)


def test_half_a_pair_of_streams_holds_no_descriptor(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise each topic might get one stream of its pair from the last descriptors, and none would connect."""
    out = robot.publisher("/scan")
    port = free_port()
    message = Scarcity.ROUTE_WITHOUT_STREAM(side="client", limit=150, remedy=MORE_DESCRIPTORS)
    opened: list[bool] = []
    open_stream: Callable[..., Awaitable[Failure | None]] = replaced.OPEN_DATA_STREAM.value

    async def one_left(self: ClientChannels, transport: StreamTransport, port: int, *, large: bool) -> Failure | None:
        if large:
            return Failure(message)
        failure = await open_stream(self, transport, port, large=large)
        opened.append(failure is None)
        return failure

    def carriers() -> list[int]:
        links = [each for engine in (server, client) for each in inside(engine).role.links()]
        return [len(each.carriers()) for each in links]

    with monkeypatch.context() as short:
        replaced.OPEN_DATA_STREAM.set(short, one_left)
        server, client = bridge.both(Topic("/scan", "transmit", port=port))
        eventually(lambda: message in route(client, "/scan").reason)
        eventually(lambda: carriers() == [1, 1], what="nothing but the control connection is open")
        eventually(lambda: opened.count(True) > 1, what="it is tried again from the beginning")
    eventually(out.get_subscription_count, what="subscribed")
    # A client may use its second stream a moment before the server has counted it.
    eventually(lambda: carriers() == [3, 3], what="both streams and the control connection")
    client.remove_topic(route(client, "/scan").key).result(60)
    eventually(lambda: carriers() == [1, 1])


def test_simultaneous_topics_share_descriptors(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairs that all take their first one before any takes its second never have both, however often they try."""
    ports = free_ports(8)
    topics = [Topic(f"/topic{port}", "transmit", type="std_msgs/msg/String", qos=1, port=port) for port in ports]

    def left() -> int:
        """Six; sockets that are being opened count, too."""
        links = inside(client).role.links()
        return 6 - sum(len(each.carriers()) - 1 for each in links if each.linked) - opening

    opening, in_vain = 0, list[bool]()
    open_stream: Callable[..., Awaitable[Failure | None]] = replaced.OPEN_DATA_STREAM.value

    async def opens(self: ClientChannels, transport: StreamTransport, port: int, *, large: bool) -> Failure | None:
        nonlocal opening
        if left() < 1:
            in_vain.append(large)
            return Failure("none is left")
        opening += 1
        try:
            return await open_stream(self, transport, port, large=large)
        finally:
            opening -= 1

    short = SimpleNamespace(left=left, scarce=lambda: False, scarcity_message=lambda _: "none is left")
    replaced.OPEN_DATA_STREAM.set(monkeypatch, opens)
    client = bridge.client(*topics)
    replaced.CLIENTS_DESCRIPTORS.set(monkeypatch, short)
    server = bridge.server(ports=ports)
    eventually(lambda: sum(event.code == EventCode.ROUTE_CONNECTED for event in server.events()) >= 3)
    eventually(lambda: [len(each.carriers()) for each in inside(client).role.links()] == [7])
    eventually(lambda: any("none is left" in route.reason for route in now(client).routes))
    assert in_vain == [], "the first to begin gets both"


def test_client_opens_no_socket_for_datagrams_from_reserve(
    bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server may ask for many ports, and each takes one. It goes on once there are enough again."""
    out = robot.publisher("/scan")
    with monkeypatch.context() as short:
        replaced.DESCRIPTORS_SCARCE.set(short, lambda: True)
        _, client = bridge.both(Topic("/scan", "transmit", protocol="udp"))
        eventually(lambda: happened(client, EventCode.LINK_UDP_BLOCKED, Scarcity.ROUTE_WITHOUT_STREAM))
    eventually(out.get_subscription_count, what="subscribed")
