"""The ports of their own that clients' topics may have a server bind."""

from __future__ import annotations

from typing import Any

import pytest
from tests.support.bridge import Bridge, happened, linked, route, says
from tests.support.ports import free_port, free_ports
from tests.support.rogue import Rogue
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.topic_ports import PortDenied, TopicPorts, check_topic_port
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import DEFAULT_PORT, PORTS_PER_CLIENT, dds_ports, discovery_domain
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.transports import named
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import Accept, Close, Propose, Refuse

TCP, UDP, RFCOMM = (named(name)() for name in ("tcp", "udp", "bluetooth"))
SESSION = Session(name="pc", role="server", server_ip="0.0.0.0", server_port=7060)


def asks(rogue: Rogue, number: int, port: int, transport: Any = "udp") -> Accept | Refuse:
    """Return the server's answer for a topic with a port of its own."""
    name = f"/t{number}"
    rogue.say(Propose(route=number, topic=name, remote_topic=name, from_client=True, transport=transport, port=port))
    return answer_of(rogue)


def answer_of(rogue: Rogue) -> Accept | Refuse:
    answer = rogue.wait_for(Accept, Refuse)
    assert isinstance(answer, Accept | Refuse)
    return answer


@pytest.mark.parametrize("protocol", ["udp", "tcp"])
def test_discovery_port_of_domain_is_refused_twice(protocol: Any, bridge: Bridge) -> None:
    """ROS nodes of the server's machine would no longer find each other."""
    port = 7400 + 250 * bridge.pc.id + 249
    server, client = bridge.both(Topic("/scan", "transmit", protocol=protocol, port=port))
    domain = bridge.pc.id
    reason = PortDenied.DISCOVERY(kind="port", port=port, domain=domain, ports=dds_ports(domain))
    for engine in (server, client):
        eventually(lambda engine=engine: says(engine, "/scan", reason))
    assert happened(server, EventCode.ROUTE_REFUSED, f"port {port}")


@pytest.mark.parametrize(
    ("domain", "port", "is_free"),
    [(0, 7399, True), (0, 7400, False), (0, 7649, False), (0, 7652, True), (1, 7649, True), (18, 12001, False)]
    + [(domain, port, True) for domain in (0, 1, 17, 19) for port in (12001, 12012)],
)
def test_the_ports_of_a_domain(domain: int, port: int, is_free: bool) -> None:
    """The thesis's sessions name 12001 to 12012, which are domain 18's."""
    for transport in (TCP, UDP):
        if is_free:
            check_topic_port(domain, transport, port)
        else:
            with pytest.raises(ListenError, match=pattern(PortDenied.DISCOVERY, port=port, domain=domain)):
                check_topic_port(domain, transport, port)
    with pytest.raises(ListenError, match=pattern(PortDenied.OUT_OF_RANGE, port=1023, allowed=TCP.topic_ports)):
        check_topic_port(domain, TCP, 1023)


@pytest.mark.parametrize("domain", [0, 1, 17, 101, 102, 232])
@pytest.mark.parametrize("offset", [0, 1, 10, 11, 74, 75])
def test_a_discovery_port_of_any_domain_is_refused(domain: int, offset: int) -> None:
    """Other domains may have nodes on the server's machine, which would no longer find each other."""
    port = 7400 + 250 * domain + offset
    assert discovery_domain(port) == domain
    for transport in (TCP, UDP):
        with pytest.raises(ListenError):
            check_topic_port(18, transport, port)


@pytest.mark.parametrize("port", [DEFAULT_PORT, 7061, 7399, 12001, 12012, 49152, 49153, 65535])
def test_ports_of_samples_are_no_discovery_ports(port: int) -> None:
    assert discovery_domain(port) is None
    check_topic_port(0, UDP, port)


def test_peer_gets_no_discovery_port_of_another_domain(bridge: Bridge) -> None:
    bridge.server(ports=tuple(range(7400, 7700)))  # a list does not allow it either
    other = 1 if bridge.pc.id != 1 else 2
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        for at, offset in enumerate((0, 1, 10, 11)):
            answer = asks(rogue, 2 * at + 1, 7400 + 250 * other + offset)
            assert isinstance(answer, Refuse)
            assert answer.code == "port_taken"


def test_a_client_has_so_many_however_it_asks(bridge: Bridge) -> None:
    """All at once, one after the other, or over several links; what it gives back, it may have again."""
    server = bridge.server()
    secret = read_key(bridge.folder / bridge.key_file).secret
    *ports, another = free_ports(PORTS_PER_CLIENT + 2)
    with Rogue(bridge.port, secret) as rogue:
        proposals = [
            Propose(
                route=2 * at + 1, topic=f"/t{at}", remote_topic=f"/t{at}", from_client=True, transport="udp", port=port
            )
            for at, port in enumerate(ports)
        ]
        rogue.say(*proposals)
        answers = [answer_of(rogue) for _ in ports]
        (refused,) = [answer for answer in answers if isinstance(answer, Refuse)]
        assert PortDenied.TOO_MANY(client="robot1", limit=PORTS_PER_CLIENT) in refused.reason
        accepted = next(answer.route for answer in answers if isinstance(answer, Accept))
        rogue.say(Close(route=accepted, reason="", code=EndCode.REMOVED))
        assert isinstance(asks(rogue, 101, ports[-1]), Accept)
        assert isinstance(asks(rogue, 103, another), Refuse)
    eventually(lambda: not linked(server))
    with Rogue(bridge.port, secret) as rogue:  # the ports of the link before are free again
        for at, port in enumerate(ports[:-1]):
            assert isinstance(asks(rogue, 2 * at + 1, port), Accept)
        assert isinstance(asks(rogue, 201, ports[-1]), Refuse)


@pytest.mark.parametrize("ports", [(), "none"])
def test_none(ports: Any, bridge: Bridge) -> None:
    port = free_port()
    server, client = (
        bridge.server(ports=ports),
        bridge.client(Topic("/a", "transmit", port=port), Topic("/b", "transmit")),
    )
    reason = PortDenied.NOT_LISTED(port=port, allowed="none")
    for engine in (server, client):
        eventually(lambda engine=engine: linked(engine) and says(engine, "/a", reason))
    assert not route(client, "/b").reason.startswith("refused")


def test_a_list_is_what_clients_may_have() -> None:
    listed = tuple(range(12001, 12031))
    session = Session(name="pc", role="server", server_ip="::", server_port=7060, ports=listed)
    ports = TopicPorts("robot1")
    for port in listed:
        ports.reserve(session, UDP, port)
    with pytest.raises(ListenError, match=r"port 12031: .* 12001, .* and 18 more; "):
        ports.reserve(session, UDP, 12031)
    ports.reserve(session, RFCOMM, 5)


def test_topics_that_share_a_channel_count_once() -> None:
    ports = TopicPorts("robot1")
    released = [ports.reserve(SESSION, RFCOMM, 5) for _ in range(PORTS_PER_CLIENT + 1)]
    for port in range(5000, 5000 + PORTS_PER_CLIENT - 1):
        ports.reserve(SESSION, TCP, port)
    with pytest.raises(ListenError):
        ports.reserve(SESSION, TCP, 6000)
    for release in released[1:]:
        release()
    with pytest.raises(ListenError):
        ports.reserve(SESSION, TCP, 6000)
    released[0]()
    ports.reserve(SESSION, TCP, 6000)
