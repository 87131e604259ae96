"""Messages arrive byte by byte as sent: every type, every size, every transport."""

from __future__ import annotations

import random
import zlib
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.serialization import serialize_message
from tests.engine.bytes_helpers import INSTALLED
from tests.support import replaced
from tests.support.bridge import Bridge, carries, happened, heard, link, protocol_of, route, settled
from tests.support.domain import LATCHED, Domain, text
from tests.support.filled import filled
from tests.support.long import long, long_cases
from tests.support.participants import KnownNode, agree
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.route.sending import USE_TCP
from rsb_bridge.wire.sealing import CipherSuite

MADE_UP_HASH = "RIHS01_" + "5a" * 32
CDR = b"\x00\x01\x00\x00"
MEGABYTE = 1 << 20


@pytest.mark.parametrize("protocol", ["tcp", *long("udp")])
def test_every_common_type(protocol: Any, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    topics = {f"/{name.replace('/', '_').lower()}": kind for name, kind in INSTALLED.items()}
    assert len(topics) > 100
    listeners = {topic: pc.listener(topic, kind) for topic, kind in topics.items()}
    publishers = {topic: robot.publisher(topic, kind) for topic, kind in topics.items()}
    server = bridge.server()
    # Of any age, as of commands only the newest waits.
    bridge.client(*(Topic(topic, "transmit", protocol=protocol, max_age=0.0) for topic in topics))
    carries(publishers.values(), server, topics)
    sent = {topic: [serialize_message(message) for message in (kind(), filled(kind))] for topic, kind in topics.items()}
    for topic, payloads in sent.items():
        for payload in payloads:
            publishers[topic].publish(payload)
    eventually(lambda: all(len(each.payloads) == 2 for each in listeners.values()))
    assert {topic: each.payloads for topic, each in listeners.items()} == sent


@pytest.fixture
def unknown(bridge: Bridge) -> Iterator[tuple[KnownNode, KnownNode]]:
    """Nodes for types that rclpy does not know, one in the robot's domain and one in the PC's."""
    nodes = KnownNode(bridge.robot.id, "sends"), KnownNode(bridge.pc.id, "hears")
    for node in nodes:
        node.start()
    yield nodes
    for node in nodes:
        node.stop()


def sizes(limit: int) -> list[int]:
    """Bytes behind the CDR header: none, around the borders of datagrams and buffers, up to the limit."""
    borders = (0, 1, 3, 1_400, 65_400, 65_507, 65_536, 262_144, 1_000_003, 3 * MEGABYTE, 8 * MEGABYTE)
    return [size for size in borders if size <= limit]


@pytest.mark.parametrize(
    ("type_name", "protocol", "limit"),
    [
        ("made_up_msgs/msg/Blob", "tcp", 8 * MEGABYTE),
        ("tf2_msgs/msg/TFMessage", "udp", MEGABYTE),
        *long_cases(("tf2_msgs/msg/TFMessage", "tcp", 8 * MEGABYTE), ("made_up_msgs/msg/Blob", "udp", MEGABYTE)),
    ],
)
def test_type_that_neither_side_has_in_every_size(
    type_name: str, protocol: Any, limit: int, bridge: Bridge, unknown: tuple[KnownNode, KnownNode]
) -> None:
    robot, pc = unknown
    received: list[bytes] = []
    spec = TopicSpec("/blob", type_name, MADE_UP_HASH, Qos(depth=20))
    publisher = robot.advertise(spec, "robot")
    pc.subscribe(spec, lambda batch: received.extend(t.payload for t in batch), "pc")
    server, client = bridge.both(Topic("/blob", "transmit", protocol=protocol))
    eventually(lambda: publisher.subscriber_count)
    eventually(lambda: [s for s in route(server, "/blob").stages if s.name == "subscriber seen" and s.done])
    eventually(
        lambda: agree(bridge.robot.id, "/blob") and agree(bridge.pc.id, "/blob"), what="both ends know the other"
    )
    assert route(server, "/blob").type_hash == MADE_UP_HASH
    source = random.Random(1)
    for count, size in enumerate(sizes(limit), 1):
        payload = CDR + source.randbytes(size)
        publisher.publish(payload)
        eventually(lambda count=count: len(received) >= count, what=f"{size} bytes")
        assert zlib.crc32(received[-1]) == zlib.crc32(payload)
        assert received[-1] == payload
    ledger = settled(client, "/blob", len(sizes(limit)))
    assert ledger.delivered == len(sizes(limit))


@pytest.mark.parametrize(
    ("address", "changes"),
    [
        ("::1", {}),
        ("localhost", {}),
        ("127.0.0.1", {"use_encryption": False, "key_file": None}),
        ("127.0.0.1", {"use_name": True}),
    ],
    ids=["IPv6", "host name", "unencrypted", "prefixed"],
)
def test_both_ways_over(address: str, changes: dict[str, Any], bridge: Bridge, robot: Domain, pc: Domain) -> None:
    prefix = "/robot1" if changes.get("use_name") else ""
    outs, backs = ("/out_tcp", "/out_udp"), ("/back_tcp", "/back_udp")
    theirs = [prefix + name for name in outs]
    out, there = [robot.publisher(name) for name in outs], [pc.listener(name) for name in theirs]
    home, back = [pc.publisher(prefix + name) for name in backs], [robot.listener(name) for name in backs]
    topics = [Topic(name, "transmit", protocol=protocol_of(name)) for name in outs]
    topics += [Topic(name, "receive", protocol=protocol_of(name)) for name in backs]
    server, client = bridge.both(*topics, server_ip=address, **changes)
    carries(out, server, theirs)
    carries(home, client, backs)
    for publisher in (*out, *home):
        publisher.publish(text(f"from {publisher.topic} " * 20_000))
    for publisher, listener in zip((*out, *home), (*there, *back), strict=True):
        assert heard(listener, 1) == [text(f"from {publisher.topic} " * 20_000)]
    encrypted = changes.get("use_encryption", True)
    for engine in (server, client):
        assert link(engine).encrypted is encrypted
        assert bool(link(engine).cipher) is encrypted
        assert (happened(engine, EventCode.KEY_UNENCRYPTED) is None) is encrypted


@pytest.mark.parametrize("slow_side", ["server", *long("client")])
def test_chacha_where_one_side_has_no_aes(
    slow_side: str, bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A processor without AES instructions cannot be had here: what it would say of itself is put in its place."""
    there, out = pc.listener("/out"), robot.publisher("/out")
    suites = {"server": CipherSuite.AESGCM, "client": CipherSuite.AESGCM, slow_side: CipherSuite.CHACHAPOLY}
    replaced.PREFERRED_SUITE.set(monkeypatch, lambda: suites["server"])
    server = bridge.server()
    replaced.PREFERRED_SUITE.set(monkeypatch, lambda: suites["client"])
    client = bridge.client(Topic("/out", "transmit"), Topic("/udp", "transmit", protocol="udp"))
    carries([out], server, ["/out"])
    out.publish(text("there"))
    assert heard(there, 1) == [text("there")]
    eventually(lambda: link(server).cipher == link(client).cipher == "CHACHAPOLY")


def test_ports_of_their_own(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Both transports, both ways; an edit that keeps the port finds it free again."""
    from tests.support.ports import free_ports

    tcp, udp = free_ports(2)
    names = ("/t", "/u", "/tb", "/ub")
    topics = (
        Topic("/t", "transmit", protocol="tcp", port=tcp),
        Topic("/u", "transmit", protocol="udp", port=udp),
        Topic("/tb", "receive", protocol="tcp", port=tcp),
        Topic("/ub", "receive", protocol="udp", port=udp),
    )
    listeners = {name: (pc if len(name) == 2 else robot).listener(name) for name in names}
    publishers = {name: (robot if len(name) == 2 else pc).publisher(name) for name in names}
    server, client = bridge.both(*topics)
    assert [route(client, name).port for name in names] == [tcp, udp, tcp, udp]

    def all_cross(count: int) -> None:
        carries([publishers["/t"], publishers["/u"]], server, ["/t", "/u"])
        carries([publishers["/tb"], publishers["/ub"]], client, ["/tb", "/ub"])
        for name, publisher in publishers.items():
            publisher.publish(text(name))
        for listener in listeners.values():
            heard(listener, count)

    all_cross(1)
    for topic in topics:
        edited = Topic(topic.topic, topic.direction, protocol=topic.protocol, port=topic.port, max_rate=1000.0)
        client.edit_topic(route(client, topic.topic).key, edited).result(60)
    all_cross(2)
    for name in names:
        client.remove_topic(route(client, name).key).result(60)
    import socket

    def both_free() -> bool:
        try:
            with socket.socket() as one, socket.socket(type=socket.SOCK_DGRAM) as other:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                one.bind(("127.0.0.1", tcp))
                other.bind(("127.0.0.1", udp))
        except OSError:
            return False
        return True

    eventually(both_free)


def test_compressed(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Text is sent compressed; noise as it is."""
    names = ("/tcp", "/udp")
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    server, client = bridge.both(*(Topic(n, "transmit", protocol=protocol_of(n), compression="zstd") for n in names))
    carries(outs, server, names)
    noise = "".join(random.Random(1).choices("0123456789abcdefghijklmnopqrstuvwxyz", k=20_000))
    sent = [text("free space " * 40_000), text(noise), text("")]
    for name, there, out in zip(names, theres, outs, strict=True):
        for payload in sent:
            out.publish(payload)
        assert heard(there, 3) == sent
        settled(client, name, 3)
        assert route(client, name).bytes_total < 30_000


def test_message_too_large_for_udp_is_counted(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out, there = robot.publisher("/big"), pc.listener("/big")
    server, client = bridge.both(Topic("/big", "transmit", protocol="udp", qos="default"))
    carries([out], server, ["/big"])
    out.publish(text("x" * (8 * MEGABYTE)))
    out.publish(text("small"))
    assert heard(there, 1) == [text("small")]
    ledger = settled(client, "/big", 2)
    assert ledger.dropped == {"too large": 1}
    assert happened(client, EventCode.ROUTE_TOO_LARGE, USE_TCP)
    assert USE_TCP in route(client, "/big").last_error


def test_oversized_latched_message_is_down_on_both_sides(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """It is published once, and so no share of the topic's messages."""
    out = robot.publisher("/map", qos=LATCHED)
    out.publish(text("x" * (9 * MEGABYTE)))
    sides = bridge.both(Topic("/map", "transmit", protocol="udp"))

    def judged(state: State, cause: Cause) -> bool:
        shown = [route(side, "/map") for side in sides]
        return [(each.state, each.cause) for each in shown] == [(state, cause)] * 2

    eventually(lambda: judged(State.DOWN, Cause.TOO_LARGE))
    there = pc.listener("/map", qos=LATCHED)
    out.publish(text("small"))
    assert heard(there, 1) == [text("small")]
    eventually(lambda: judged(State.OK, Cause.NONE))
    out.publish(text("x" * (9 * MEGABYTE)))
    eventually(lambda: judged(State.SLOW, Cause.TOO_LARGE))
