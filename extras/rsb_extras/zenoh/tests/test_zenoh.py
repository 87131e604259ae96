"""Whole bridges over a Zenoh network: traffic, verdicts of both sides, and a router that dies."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.wire.preamble import RefusalText
from rsb_extras.zenoh.endpoint import EndpointProblem
from rsb_extras.zenoh.pipe import PipeProblem
from rsb_extras.zenoh.tests import zenoh_places
from rsb_extras.zenoh.unreachable import Unreachable
from rsb_extras.zenoh.zenoh_transport import FleetText

pytest.importorskip("zenoh")  # an extra

from rclpy.qos import QoSProfile, ReliabilityPolicy
from tests.support.bridge import balance, carries, connections, happened, heard, link, linked, outgoing, route, settled
from tests.support.constants import STREAM_STALLED_AFTER
from tests.support.domain import LATCHED, text
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.channel.scheduler import LEAST_CHUNK
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh import endpoint as endpoints
from rsb_extras.zenoh.sample_header import Header, SampleKind
from rsb_extras.zenoh.tests.zenoh_router import Router, stranger

if TYPE_CHECKING:
    import zenoh
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs

    from rsb_bridge.engine import Engine

MEGABYTE = 1 << 20
BEST_EFFORT = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)


def over(*routers: Router, **settings: Any) -> dict[str, Any]:
    """Return the fields of a session over Zenoh."""
    connect = tuple(each.endpoint for each in routers)
    return {"server_ip": "zenoh", "server_port": 0, "features": {"zenoh": ZenohSettings(connect=connect, **settings)}}


def both_linked(*engines: Engine) -> None:
    eventually(lambda: all(linked(each) for each in engines), what="linked")


def answered(engine: Engine) -> bool:
    """Ask the other side; return whether it has answered."""
    try:
        engine.topics("robot1").result(60)
    except EngineError:
        return False
    return True


@pytest.mark.parametrize("direction", ["transmit", "receive"])
def test_what_crosses_is_what_was_published(
    direction: Any, bridge: Bridge, router: Router, robot: Domain, pc: Domain
) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    names = ("/stream", "/drop")
    theres = [far.listener("/stream"), far.listener("/drop", qos=BEST_EFFORT)]
    outs = [near.publisher(name) for name in names]
    qos: tuple[dict[str, Any], ...] = ({"depth": 200}, {"depth": 200, "reliability": "best_effort"})
    topics = (Topic(name, direction, qos=each) for name, each in zip(names, qos, strict=True))
    server, client = bridge.both(*topics, **over(router))
    sender, receiver = (client, server) if direction == "transmit" else (server, client)
    carries(outs, receiver, names)
    assert [route(sender, name).transport for name in names] == ["zenoh", "zenoh-drop"]
    for name, there, out in zip(names, theres, outs, strict=True):
        size = 40_000 if name == "/stream" else 400  # what is dropped is not more than waits anywhere
        sent = [text(f"{number} " + "x" * (number % 5) * size) for number in range(100)]
        for each in sent:
            out.publish(each)
        assert heard(there, 100) == sent
        settled(sender, name, 100, delivered=lambda: 100)


def test_lazy_topic_rests_over_zenoh(bridge: Bridge, router: Router, robot: Domain, pc: Domain) -> None:
    out = robot.publisher("/image", qos=BEST_EFFORT)
    server, client = bridge.both(Topic("/image", "transmit", lazy=True), **over(router))
    eventually(lambda: {route(engine, "/image").state for engine in (server, client)} == {State.RESTING})
    assert out.get_subscription_count() == 0
    there = pc.listener("/image", qos=BEST_EFFORT)
    carries([out], server, ["/image"])
    out.publish(text("an image"))
    assert heard(there, 1) == [text("an image")]


def test_a_router_that_is_killed_and_comes_back(bridge: Bridge, router: Router, robot: Domain, pc: Domain) -> None:
    there, out = pc.listener("/scan"), robot.publisher("/scan")
    pc.listener("/map", qos=LATCHED), robot.publisher("/map", qos=LATCHED).publish(text("a map"))
    server, client = bridge.both(Topic("/scan", "transmit"), Topic("/map", "transmit"), **over(router))
    carries([out], server, ["/scan"])
    eventually(lambda: {route(engine, "/map").state for engine in (server, client)} == {State.OK})
    router.kill()
    eventually(lambda: not linked(server) and not linked(client), what="both notice")
    eventually(lambda: link(client).cause == LinkCause.UNREACHABLE)
    assert router.endpoint in link(client).reason
    assert says(link(client).reason, Unreachable.NOBODY_LISTENS)
    eventually(lambda: link(server).cause == LinkCause.ROUTER_LOST)
    assert link(server).state is State.DOWN
    assert router.endpoint in link(server).reason
    assert any(event.cause == LinkCause.ROUTER_LOST for event in server.events())
    router.start()
    eventually(lambda: link(server).cause != LinkCause.ROUTER_LOST)
    both_linked(server, client)
    carries([out], server, ["/scan"])
    out.publish(text("again"))
    eventually(lambda: text("again") in there.payloads)
    eventually(lambda: {route(engine, "/map").state for engine in (server, client)} == {State.OK}, what="the map's")


def test_a_second_router_takes_over(bridge: Bridge) -> None:
    first = Router()
    second = Router(connect={"endpoints": [first.endpoint]})
    try:
        server, client = bridge.both(**over(first, second))
        first.kill()
        # Questions, as nobody may notice anything: both may have used the second one already.
        eventually(lambda: answered(client) and answered(server), what="a question over the second one")
        second.kill()
        eventually(lambda: not linked(server) and not linked(client), what="noticed")
        first.start()
        both_linked(server, client)
    finally:
        first.close()
        second.close()


def test_link_comes_once_there_is_router(bridge: Bridge, router: Router) -> None:
    router.kill()
    server, client = bridge.server(**over(router)), bridge.client(**over(router))
    eventually(lambda: link(client).cause == LinkCause.UNREACHABLE)
    assert says(link(client).reason, Unreachable.NOBODY_LISTENS)
    event = eventually(lambda: happened(server, EventCode.ENGINE_NOT_LISTENING))
    assert says(event.text, Unreachable.NOBODY_LISTENS)
    router.start()
    both_linked(server, client)


def test_without_a_server_the_client_says_so(bridge: Bridge, router: Router) -> None:
    """A server of another fleet is none of its own."""
    other = bridge.server(**over(router, fleet="another"))
    eventually(lambda: happened(other, EventCode.ENGINE_LISTENING))
    client = bridge.client(**over(router, fleet="harbour"))
    eventually(lambda: link(client).cause == LinkCause.UNREACHABLE)
    assert says(link(client).reason, FleetText.NO_SERVER, fleet="harbour")
    server = bridge.server(**over(router, fleet="harbour"))
    both_linked(server, client)


def test_servers_of_one_fleet_are_named_on_both(bridge: Bridge, router: Router) -> None:
    """The second of two servers with one key does not listen: the client could not tell them apart."""
    first, client = bridge.both(**over(router))
    twin = bridge.server(**over(router))
    eventually(lambda: happened(twin, EventCode.ENGINE_NOT_LISTENING))
    assert happened(twin, EventCode.ENGINE_OTHER_SERVERS) is None
    eventually(lambda: happened(first, EventCode.ENGINE_OTHER_SERVERS))
    second = bridge.server(name="other", **over(router))
    eventually(lambda: happened(second, EventCode.ENGINE_OTHER_SERVERS))
    other = bridge.client(name="other", **over(router))
    eventually(lambda: linked(other, "other") and linked(second, "other"), what="linked")
    assert linked(first)
    assert linked(client)


def test_server_finds_client_by_former_key(bridge: Bridge, router: Router) -> None:
    """The client may still use that key, and could not tell the two servers apart."""
    first = bridge.server(**over(router))
    eventually(lambda: happened(first, EventCode.ENGINE_LISTENING))
    twin = bridge.server(next_key_file=bridge.make_key("next"), **over(router))
    eventually(lambda: happened(twin, EventCode.ENGINE_NOT_LISTENING))


def test_client_that_is_killed_is_missed_at_once(bridge: Bridge, router: Router, programs: Programs) -> None:
    """Its token goes with it: the server does not wait until it has been silent for long."""
    server = bridge.server(**over(router))
    program = programs.start(bridge.client_session(**over(router)))
    eventually(lambda: linked(server))
    program.signal(signal.SIGKILL)
    eventually(lambda: not linked(server))
    lost = eventually(lambda: happened(server, EventCode.LINK_LOST))
    assert EndpointProblem.PEER_LEFT() in lost.text


def test_a_wrong_key_is_named_on_both_sides(bridge: Bridge, router: Router) -> None:
    server = bridge.server(**over(router))
    client = bridge.client(key_file=bridge.make_key("other"), **over(router))
    eventually(lambda: link(client).cause == link(server).cause == LinkCause.WRONG_KEY)
    assert says(link(client).reason, RefusalText.KEYS_DIFFER, name="robot1")


def test_datagrams_that_network_drops_are_in_ledger(
    bridge: Bridge, router: Router, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, out = pc.listener("/drop", qos=BEST_EFFORT), robot.publisher("/drop")
    qos = {"depth": 500, "reliability": "best_effort"}
    server, client = bridge.both(Topic("/drop", "transmit", qos=qos), **over(router))
    carries([out], server, ["/drop"])
    take, count = zenoh_places.RECEIVE_DATAGRAM.value, [0]

    def lossy(self: endpoints.ZenohEndpoint, sender: str, payload: bytes) -> None:
        if self._service == "server" and len(payload) > 500:
            count[0] += 1
            if count[0] % 5 == 0:
                return
        take(self, sender, payload)

    zenoh_places.RECEIVE_DATAGRAM.set(monkeypatch, lossy)
    for number in range(301):
        out.publish(text(f"{number}" + " " * 800))
        eventually(lambda number=number: count[0] > number)  # one datagram each, so that the loss can be computed
    ledger = settled(client, "/drop", 301, delivered=lambda: 301 - 60)
    eventually(lambda: len(there.payloads) >= ledger.delivered)  # DDS may bring the last ones a moment later
    assert ledger.delivered == len(there.payloads)
    assert ledger.dropped_total == 60
    assert balance(ledger) == 301
    eventually(lambda: route(server, "/drop").ledger == ledger)


def test_stream_that_misses_sample_goes_on(
    bridge: Bridge, router: Router, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    STREAM_STALLED_AFTER.set(monkeypatch, 60.0)
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    server, client = bridge.both(Topic("/odom", "transmit", qos={"depth": 100}), **over(router))
    carries([out], server, ["/odom"])
    out.publish(text("first" * 12_000))  # a stream on which nothing has got through is not replaced
    eventually(lambda: route(client, "/odom").ledger.delivered == 1)
    take = zenoh_places.RECEIVE.value
    lost: list[str] = []

    def lossy(self: endpoints.ZenohEndpoint, sender: str, stream: str, attachment: bytes, payload: bytes) -> None:
        of_a_message = self._service == "server" and len(payload) >= LEAST_CHUNK  # a large one
        if of_a_message and not lost and outgoing(client, "/odom").counts.offered == 4:
            lost.append(stream)
            return
        take(self, sender, stream, attachment, payload)

    zenoh_places.RECEIVE.set(monkeypatch, lossy)
    for number in range(3):
        out.publish(text(str(number) * 60_000))
    one_or_more = (PipeProblem.SAMPLE_LOST, PipeProblem.SAMPLES_LOST)  # Zenoh drops some itself on a busy machine
    eventually(lambda: any(happened(server, EventCode.LINK_STREAM_REOPENED, each) for each in one_or_more))
    assert linked(server)
    out.publish(text("after"))
    eventually(lambda: text("after") in there.payloads)
    ledger = eventually(lambda: found if not (found := route(client, "/odom").ledger).open else None)
    assert balance(ledger) == ledger.offered == 5
    assert ledger.delivered == len(there.payloads)


def test_stranger_who_floods_and_replays_moves_no_budget(
    bridge: Bridge, router: Router, robot: Domain, pc: Domain
) -> None:
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    captured: list[tuple[str, bytes, bytes]] = []
    other = stranger(router)

    def capture(sample: zenoh.Sample) -> None:
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
        captured.append((str(sample.key_expr), sample.payload.to_bytes(), attachment))

    tap = other.declare_subscriber(f"{endpoints.ROOT}/**", capture)
    server, client = bridge.both(Topic("/odom", "transmit", qos={"depth": 100}), **over(router))
    carries([out], server, ["/odom"])
    for number in range(20):
        out.publish(text(f"{number}"))
    heard(there, 20)
    tap.undeclare()
    before = connections(server)
    for _ in range(20):
        for key, payload, attachment in captured:
            other.put(key, payload, attachment=attachment)
    address = next(iter(captured))[0].split("/")[3]
    for number in range(2000):
        header = Header(SampleKind.DATA, 0, 0).pack()
        other.put(f"{endpoints.ROOT}/fleet/at/{address}/{number:016x}/{number:016x}", bytes(1000), attachment=header)
    out.publish(text("last"))
    eventually(lambda: text("last") in there.payloads)
    assert there.payloads == [*(text(f"{number}") for number in range(20)), text("last")]
    assert linked(server)
    assert linked(client)
    assert connections(server) == before
    other.close()


def test_without_a_router_who_listens_is_connected_to(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    session = {"server_ip": "zenoh", "server_port": 0}
    there, out = pc.listener("/scan"), robot.publisher("/scan")
    server = bridge.server(features={"zenoh": ZenohSettings(listen=(where,))}, **session)
    client = bridge.client(Topic("/scan", "transmit"), features={"zenoh": ZenohSettings(connect=(where,))}, **session)
    both_linked(server, client)
    carries([out], server, ["/scan"])
    out.publish(text("direct"))
    heard(there, 1)
    client.stop()
    eventually(lambda: not linked(server))
    assert link(server).cause in {LinkCause.CLOSED, LinkCause.LOST}
