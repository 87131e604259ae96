"""Unauthenticated connections are refused, with the reason on both sides, while clients are served."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import constants
from tests.support.bridge import carries, happened, heard, link, linked, now, settled
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.relay import message_number
from tests.support.rogue import Rogue
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.pending_connections import Rejected
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.preamble import PreambleKind, RefusalText
from rsb_bridge.wire.protocol_error import Broken
from rsb_bridge.wire.sealing import CipherSuite, InvalidSeal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.wording import Wording

HZ = 50


def served(engine: Engine, out: Publisher, there: Listener, seconds: float = 0.5) -> None:
    """Publish at 50 Hz for a while: every message arrives, in order, during the disturbance."""
    count = len(there.payloads)
    sent = [text(f"{number}") for number in range(int(seconds * HZ))]
    began = time.monotonic()
    for number, payload in enumerate(sent):
        out.publish(payload)
        time.sleep(max(0.0, began + (number + 1) / HZ - time.monotonic()))
    heard(there, count + len(sent))
    assert there.payloads[count:] == sent
    assert linked(engine)


@pytest.fixture
def friend(bridge: Bridge, robot: Domain, pc: Domain) -> Iterator[tuple[Engine, Engine, Publisher, Listener]]:
    """A server with two known clients, one of which, robot1, is linked and sends."""
    bridge.make_key("other")
    clients = (Client("robot1"), Client("robot2", key_file="other.key"))
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    server = bridge.server(name="pc", clients=clients)
    client = bridge.client(Topic("/beat", "transmit"))
    carries([out], server, ["/beat"])
    yield server, client, out, there
    served(client, out, there)


def test_those_who_must_not_come_in(friend: Any, bridge: Bridge) -> None:
    """A wrong key, an unknown name, and no key against a key: both sides say what to do."""
    server, _, out, there = friend
    add, encrypt = "run rsb-console client add robot3", RefusalText.ENCRYPTION_REQUIRED(name="robot2")
    wanted: tuple[tuple[dict[str, Any], EventCode, str, str], ...] = (
        ({"name": "robot2"}, EventCode.LINK_WRONG_KEY, "'robot2'", "'robot2'"),
        ({"name": "robot3"}, EventCode.LINK_UNKNOWN_NAME, f"'robot3': {add}", f"'robot3': {add.removeprefix('run ')}"),
        ({"name": "robot2", "use_encryption": False}, EventCode.LINK_REJECTED, encrypt, encrypt),
    )
    strangers = [bridge.client(Topic("/beat", "transmit"), **changes) for changes, *_ in wanted]
    for stranger, (changes, code, told, logged) in zip(strangers, wanted, strict=True):
        eventually(lambda stranger=stranger, told=told: happened(stranger, EventCode.LINK_REFUSED, told))
        eventually(lambda code=code, logged=logged: happened(server, code, logged))
        assert not linked(stranger, changes["name"])
    for engine in (*strangers, server):
        assert bridge.secret() not in "".join(event.text for event in engine.events())
    served(server, out, there)


def test_a_name_that_differs_from_the_servers(bridge: Bridge) -> None:
    """A server that lists no clients lets one in, of its own name."""
    server = bridge.server(name="pc")
    stranger = bridge.client()
    eventually(lambda: link(stranger).cause == LinkCause.UNKNOWN_NAME)
    assert happened(server, EventCode.LINK_UNKNOWN_NAME, "'pc'")
    eventually(
        lambda: [(each.name, each.cause) for each in now(server).refused] == [("robot1", LinkCause.UNKNOWN_NAME)]
    )


def test_refused_client_that_is_added_disappears(friend: Any, bridge: Bridge) -> None:
    server, *_ = friend
    unknown = bridge.client(name="robot9", key_file=bridge.make_key("nine"))
    eventually(lambda: [each.name for each in now(server).refused] == ["robot9"])
    server.add_client(Client("robot9", key_file="nine.key")).result(60)
    assert not now(server).refused
    eventually(lambda: linked(unknown, "robot9"))


def test_a_key_against_none(bridge: Bridge) -> None:
    server = bridge.server(use_encryption=False)
    stranger = bridge.client()
    words = RefusalText.ENCRYPTION_NOT_POSSIBLE(name="robot1")
    eventually(lambda: happened(stranger, EventCode.LINK_REFUSED) and happened(server, EventCode.LINK_REJECTED, words))
    plain = bridge.client(use_encryption=False)
    eventually(lambda: linked(plain))


def frame(content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + content


NO_HANDSHAKES: list[tuple[bytes, str | Wording, dict[str, object]]] = [
    (b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n", Broken.FOREIGN_KNOWN, {"protocol": "HTTP"}),
    (frame(b"rsb\x09\x01whatever comes later"), RefusalText.THIS_SIDE_OLDER, {"theirs": 9}),
    (
        frame(b"rsb\x01\x01\x01\x06robot1" + bytes(200)),
        RefusalText.KEY_NOT_NAMED,
        {"name": "robot1", "there": "client", "here": "server"},
    ),
    (frame(b"rsb\x01\x02" + bytes(28)), "unknown route", {}),
]
"""A sample; tests/wire and tests/fuzz have all."""


def test_what_is_no_handshake(friend: Any, bridge: Bridge) -> None:
    """Answered with a reason, closed, and logged with the same words."""
    server, *_ = friend
    for number, (sent, why, parameters) in enumerate(NO_HANDSHAKES, 1):
        answer = talk(("127.0.0.1", bridge.port), sent, source=f"127.0.1.{number}")
        assert answer[4:9] == b"rsb\x01\x04"
        assert has_text(answer.decode(errors="replace"), why, **parameters)
        codes = EventCode.LINK_REJECTED, EventCode.LINK_WRONG_KEY
        event = eventually(
            lambda codes=codes, why=why, parameters=parameters: next(
                filter(None, (happened(server, code, why, **parameters) for code in codes)), None
            )
        )
        assert f"127.0.1.{number}:" in event.text


def talk(address: tuple[str, int], sent: bytes, source: str = "") -> bytes:
    """Send, and give back everything that comes until the other side closes."""
    answer = b""
    with socket.create_connection(address, timeout=180, source_address=(source, 0)) as stranger:
        stranger.sendall(sent)
        with contextlib.suppress(ConnectionResetError):  # it closed with something of ours unread
            while more := stranger.recv(4096):
                answer += more
    return answer


def test_half_a_handshake_and_then_nothing(friend: Any, bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred slow strangers, more than one host may have: the server serves on and lets a friend in among them."""
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 5.0)
    server, _, out, there = friend
    with contextlib.ExitStack() as crowd:
        strangers = [
            crowd.enter_context(socket.create_connection(("127.0.0.1", bridge.port), timeout=180)) for _ in range(100)
        ]
        for stranger in strangers:
            stranger.sendall(frame(b"rsb\x01\x01")[:5])
        eventually(lambda: happened(server, EventCode.LINK_REJECTED, Rejected.TOO_MANY))
        newcomer = bridge.client(name="robot2", key_file="other.key")
        eventually(lambda: linked(newcomer, "robot2"))
        served(server, out, there)
        assert Rejected.NO_HANDSHAKE(seconds=5).encode() in strangers[-1].recv(4096)
    assert happened(server, EventCode.LINK_REJECTED, Rejected.NO_HANDSHAKE, seconds=5)


def test_client_links_during_flood_from_its_address(friend: Any, bridge: Bridge) -> None:
    """Behind one NAT with a stranger who connects 500 times a second, silently or under a random name, the client is
    served.
    """
    server, _, out, there = friend
    with flood(bridge.port, 500, b"") as silent, flood(bridge.port, 50, frame(b"rsb\x01\x63")):
        eventually(lambda: happened(server, EventCode.LINK_REJECTED, Rejected.TOO_MANY))
        newcomer = bridge.client(name="robot2", key_file="other.key")
        eventually(lambda: linked(newcomer, "robot2"))
        served(server, out, there)
        eventually(lambda: silent.count >= 64)
    assert len([event for event in server.events() if event.code == EventCode.LINK_REJECTED]) <= 8


@pytest.mark.parametrize("sent", [b"", frame(b"rsb\x01\x01")[:5]], ids=["silent", "half a handshake"])
def test_client_is_read_among_many_arrivals(sent: bytes, friend: Any, bridge: Bridge) -> None:
    """All of them wait to be accepted; none may push out another that has spoken, and has not been read yet."""
    server, known, out, _ = friend
    started, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        started.set()
        go_on.wait(60)

    inside(server).context.call(hold)
    started.wait(60)
    key = read_key(bridge.folder / "other.key").secret
    with contextlib.ExitStack() as crowd:

        def strangers() -> None:
            for _ in range(150):
                stranger = crowd.enter_context(socket.create_connection(("127.0.0.1", bridge.port), timeout=180))
                stranger.sendall(sent)

        strangers()
        client = crowd.enter_context(socket.create_connection(("127.0.0.1", bridge.port), timeout=180))
        client.sendall(ClientConnection(Hello("0.1.0", "robot2", "x", 0), key, CipherSuite.AESGCM).start())
        strangers()
        go_on.set()
        assert client.recv(4096)[8] == PreambleKind.ACCEPT
    eventually(lambda: linked(known) and linked(server), what="linked, also where five seconds were held")
    carries([out], server, ["/beat"])


class Flood:
    """How many connections were made."""

    count = 0


@contextlib.contextmanager
def flood(port: int, hz: float, sent: bytes) -> Iterator[Flood]:
    """Connect so many times a second, say that, and keep 200 of the connections open."""
    made, over = Flood(), threading.Event()

    def run() -> None:
        kept: deque[socket.socket] = deque()
        while not over.wait(1 / hz):
            with contextlib.suppress(OSError):
                kept.append(socket.create_connection(("127.0.0.1", port)))
                kept[-1].sendall(sent)
                made.count += 1
            if len(kept) > 200:
                kept.popleft().close()
        for stranger in kept:
            stranger.close()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield made
    finally:
        over.set()
        thread.join()


def test_an_authenticated_peer_that_breaks_the_format(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """A byte that changes on the way: the link is cut off with a reason, and comes back by itself."""
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    server, client = bridge.both(Topic("/beat", "transmit"))
    carries([out], server, ["/beat"])
    # Streams follow their control connection: that of small messages, then that of large ones.
    for connection, code in ((0, EventCode.LINK_LOST), (-2, EventCode.ROUTE_CHANNEL_LOST)):
        relay.connections[connection].damage()
        out.publish(text("hurt"))
        eventually(
            lambda code=code: happened(server, code, InvalidSeal.FORGED) or happened(client, code, InvalidSeal.FORGED)
        )
        relay.connections[connection].damage(False)
        eventually(lambda: linked(server) and linked(client))
        carries([out], server, ["/beat"])
        count = len(there.payloads)
        out.publish(text("well"))
        heard(there, count + 1)


def test_forged_and_replayed_datagrams(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Each of ours ten times, damaged, cut short, and noise between: messages arrive as sent, once."""
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    server, client = bridge.both(Topic("/beat", "transmit", protocol="udp", qos={"depth": 1000}))
    carries([out], server, ["/beat"])

    recorded: list[bytes] = []

    def forge(datagram: bytes) -> list[bytes]:
        damaged = bytearray(datagram)
        damaged[-1] ^= 1
        claims = bytearray(datagram)
        claims[18:26] = b"\xff" * 8  # its sequence number
        return [bytes(damaged), bytes(claims), os.urandom(60), b"", datagram[:20], *[datagram] * 10]

    def record(datagram: bytes) -> list[bytes]:
        recorded.append(datagram)
        return forge(datagram)

    relay.to_server, relay.to_client = record, forge
    sent = [text(f"{number}") for number in range(100)]
    for payload in sent:
        out.publish(payload)
    assert heard(there, 100) == sent
    relay.to_server = relay.to_client = lambda datagram: [datagram]
    relay.cut()
    eventually(lambda: happened(client, EventCode.LINK_LOST) and linked(client))
    carries([out], server, ["/beat"])
    with socket.socket(type=socket.SOCK_DGRAM) as replayer:
        for datagram in filter(message_number, recorded):
            replayer.sendto(datagram, relay.target)
    out.publish(text("new"))
    heard(there, 101)
    assert there.payloads == [*sent, text("new")]
    ledger = settled(client, "/beat", 101)
    assert ledger.delivered == 101


def test_a_replayed_connection(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Every byte that a client sent, played again: neither the link nor the topic's stream lets it in."""
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    server, _ = bridge.both(Topic("/beat", "transmit"))
    carries([out], server, ["/beat"])
    out.publish(text("once"))
    heard(there, 1)
    peer = link(server).peer
    control, data = (bytes(connection.sent) for connection in relay.connections[:2])
    for recording, words in ((control, Broken.HANDSHAKE_REPLAYED(name="robot1")), (data, "unknown route")):
        talk(relay.target, recording)
        eventually(lambda words=words: happened(server, EventCode.LINK_REJECTED, words))
    assert (link(server).peer, linked(server)) == (peer, True)
    out.publish(text("twice"))
    assert heard(there, 2) == [text("once"), text("twice")]


def test_streams_arrive_in_any_order_once_each(bridge: Bridge) -> None:
    """A client opens the streams of several ports at once. One that came late was refused, and its topics ended."""
    bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as client:
        client.route("/beat", "tcp", Qos())
        assert client.open_stream(large=True, number=2000)
        assert not client.open_stream(large=False, number=2000)
        assert not client.open_stream(large=False, number=2000 - 1024), "so old numbers are forgotten"
        assert client.open_stream(large=False, number=1999)


def test_client_reopens_stream_that_server_thinks_open(bridge: Bridge) -> None:
    """A NAT may have forgotten it: the server's kernel finds that out half a minute later."""
    bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as client:
        client.route("/beat", "tcp", Qos())
        assert client.has_streams()
        assert client.open_stream(large=True)
        assert not client.streams[1].recv(1), "the server closes the old one"
