"""Memory of strangers, who have not proven a key: small, within a budget, and freed soon."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import os
import socket
import struct
import weakref
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.link.strangers_helpers import SAID, arrived, first_message, strangers_of
from tests.support import constants, replaced
from tests.support.acceptors import Accepting
from tests.support.bridge import happened, link, linked, route
from tests.support.inside import inside, pretend_linked
from tests.support.ports import free_port
from tests.support.steps import counted
from tests.support.waiting import eventually

from rsb_bridge.channel.udp_channel import UdpChannel
from rsb_bridge.config.keys import read_key
from rsb_bridge.config.rights import rights_of_client
from rsb_bridge.link.link_server import Server
from rsb_bridge.link.server_end import ClientEntry
from rsb_bridge.model.budgets import CONNECTION, Strangers
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import Stream, StreamHandler
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.wire.datagram import MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge

    from rsb_bridge.context import Context

__all__ = ["arrived"]


@pytest.mark.usefixtures("no_collector")
def test_a_refused_connection_is_freed_at_once(bridge: Bridge, arrived: list[weakref.ref[object]]) -> None:
    server = bridge.server()
    with contextlib.ExitStack() as connected:
        for number, said in enumerate(SAID.values(), 1):
            for _ in range(7):  # the last ones of an address are refused late
                source = (f"127.0.1.{number}", 0)
                sock = socket.create_connection(("127.0.0.1", bridge.port), 10, source)
                connected.enter_context(sock)
                with contextlib.suppress(OSError):
                    sock.sendall(said)
                    if said:
                        sock.shutdown(socket.SHUT_WR)
        eventually(lambda: len(arrived) == 7 * 4 * len(SAID))
    eventually(lambda: not any(each() for each in arrived), what="freed")
    assert strangers_of(server).used == 0


def test_untrusted_end_is_read_little_by_little() -> None:
    read: list[int] = []

    class Handler(StreamHandler):
        def connected(self, stream: Stream) -> None:
            self.stream = stream

        def received(self, data: bytes) -> None:
            read.append(len(data))
            if len(read) == 3:
                self.stream.trust()

    async def test() -> None:
        port = free_port()
        listener = await Tcp().listen("127.0.0.1", port, Accepting(Handler))
        with socket.create_connection(("127.0.0.1", port)) as sock:
            sock.setblocking(False)
            async with asyncio.timeout(180):
                while len(read) < 4 or max(read) <= 4096:
                    with contextlib.suppress(BlockingIOError):
                        sock.send(bytes(100_000))
                    await asyncio.sleep(0.01)
        listener.close()
        await asyncio.sleep(0.01)

    asyncio.run(test())
    assert read[:3] == [4096] * 3
    assert max(read[3:]) > 4096


def test_connection_reset_early_still_has_address() -> None:
    hosts: list[str] = []
    connected = asyncio.Event()

    class Handler(StreamHandler):
        def connected(self, stream: Stream) -> None:
            hosts.append(stream.host)
            connected.set()

    async def test() -> None:
        port = free_port()
        listener = await Tcp().listen("127.0.0.1", port, Accepting(Handler))
        with socket.create_connection(("127.0.0.1", port), source_address=("127.0.3.1", 0)) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        async with asyncio.timeout(180):
            await connected.wait()
        listener.close()
        await asyncio.sleep(0.01)

    asyncio.run(test())
    assert hosts == ["127.0.3.1"]


def test_spent_budget_closes_oldest_connection(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.STRANGERS.set(monkeypatch, functools.partial(Strangers, 5 * CONNECTION))
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 600.0)  # none goes by itself meanwhile
    server = bridge.server()
    with contextlib.ExitStack() as silent:
        first = silent.enter_context(socket.create_connection(("127.0.0.1", bridge.port)))
        for number in range(20):
            source = (f"127.0.3.{number + 1}", 0)
            silent.enter_context(socket.create_connection(("127.0.0.1", bridge.port), source_address=source))
        first.settimeout(180)
        while first.recv(4096):
            pass
        eventually(lambda: strangers_of(server).turned_away == 16)
        assert strangers_of(server).used <= 5 * CONNECTION
        eventually(lambda: happened(server, EventCode.LINK_STRANGERS))
        client = bridge.client()
        eventually(lambda: linked(client) and linked(server))
    eventually(lambda: strangers_of(server).used == 0)
    assert link(server).cause == LinkCause.NONE


def test_a_client_that_is_linked_is_no_stranger(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 600.0)  # nor is one that was given up
    server, _ = bridge.both()
    eventually(lambda: strangers_of(server).used == 0)
    secret = read_key(bridge.folder / bridge.key_file).secret
    with socket.create_connection(("127.0.0.1", bridge.port)) as recorded:
        recorded.sendall(first_message(key=secret))
        eventually(lambda: strangers_of(server).used == CONNECTION)
    eventually(lambda: strangers_of(server).used == 0)


def test_datagram_of_stranger_costs_one_call_a_link(make_context: Callable[..., Context]) -> None:
    clients = [Client(f"robot{number}") for number in range(100)]
    entries = [ClientEntry(each, (), use_name=False, rights=rights_of_client(each, "pc")) for each in clients]
    server = Server(make_context(role="server"), entries, aes=False)
    for each in server.ends.values():
        pretend_linked(each.link, SimpleNamespace())
        each.link.channels.connection_keys = SimpleNamespace(link_id=os.urandom(8))  # type: ignore[assignment]
    socket: Any = SimpleNamespace(port=1)
    channel, calls = counted(lambda: server.new_udp_channel(bytes(8), socket, ("10.0.0.66", 4242)))
    assert channel is None
    assert calls < 1.5 * len(clients)


@pytest.mark.parametrize("own_port", [False, True])
def test_datagram_for_no_topic_opens_nothing_that_lasts(bridge: Bridge, own_port: bool) -> None:
    """It is late, or of a stranger who has seen the link's id. A channel without topics is silent, or has no socket."""
    port = free_port() if own_port else bridge.port
    topics = [Topic("/scan", "transmit", protocol="udp", port=port)] if own_port else []
    server, client = bridge.both(*topics)
    (one,) = inside(server).role.links()
    datagram = struct.pack(">B5xI8s24x", MAGIC, 1, one.channels.connection_keys.link_id)

    def opened() -> list[UdpChannel]:
        return [each for each in one.carriers() if isinstance(each, UdpChannel)]

    def opens() -> list[UdpChannel]:
        stranger.sendto(datagram, ("127.0.0.1", port))
        return opened()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        eventually(opens, what="a channel")
    if own_port:
        client.remove_topic(route(client, "/scan").key).result(60)
    eventually(lambda: not opened(), what="no channel any more")
    assert not happened(server, EventCode.LINK_LOST)
