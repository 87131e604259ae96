"""A server whose ports are taken while it restarts goes on trying, and reports it."""

from __future__ import annotations

import asyncio
import socket
import time
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.bridge import STOPS_WITHIN, happened, link, linked
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.listening import ListenProblem
from rsb_bridge.transport.udp import Udp

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_bridge.transport.transport import Acceptor, Listener


class Thief:
    """Takes a port at the moment in which a restarting server does not have it."""

    def __init__(self, port: int) -> None:
        self._port = port
        self.sockets: list[socket.socket] = []

    def __call__(self, step: str) -> None:
        if step.startswith("binding"):
            self.take(socket.SOCK_STREAM)

    def take(self, kind: socket.SocketKind) -> None:
        """Bind the port."""
        taken = socket.socket(type=kind)
        if kind is socket.SOCK_STREAM:
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", self._port))
        if kind is socket.SOCK_STREAM:
            taken.listen()
        self.sockets.append(taken)

    def give_back(self) -> None:
        """Free it."""
        for each in self.sockets:
            each.close()
        self.sockets.clear()


class UdpThief(Thief):
    """Takes the UDP port only, so that the server has bound half of what it needs."""

    def __call__(self, step: str) -> None:
        if step.startswith("binding"):
            self.take(socket.SOCK_DGRAM)


@pytest.fixture
def thief(bridge: Bridge) -> Iterator[Thief]:
    made = Thief(bridge.port)
    yield made
    made.give_back()


def restart_in_vain(server: Engine, thief: Thief) -> None:
    with pytest.raises(EngineError, match=pattern(ListenProblem.TAKEN) + ".*The server keeps trying"):
        server.restart(thief).result(60)


@pytest.mark.parametrize("kind", [Thief, UdpThief], ids=["tcp", "udp"])
def test_a_restart_whose_bind_fails_is_tried_again(kind: type[Thief], bridge: Bridge) -> None:
    server, client = bridge.both()
    thief = kind(bridge.port)
    restart_in_vain(server, thief)
    assert happened(server, EventCode.ENGINE_NOT_LISTENING, ListenProblem.TAKEN)
    eventually(lambda: link(server).cause == LinkCause.UNREACHABLE)
    assert link(server).state is State.DOWN
    eventually(lambda: not linked(client))  # it hears of that a moment after the server
    holds(lambda: not linked(client), 1.0)
    listening = sum(event.code == EventCode.ENGINE_LISTENING for event in server.events())
    thief.give_back()
    eventually(lambda: linked(client) and linked(server))
    assert sum(event.code == EventCode.ENGINE_LISTENING for event in server.events()) == listening + 1


def test_no_client_links_while_a_port_is_missing(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long it takes to find out that the datagrams' port is taken."""
    bind = Udp.listen

    async def bind_late(self: Udp, host: str, port: int, acceptor: Acceptor) -> Listener:
        await asyncio.sleep(1.5)
        return await bind(self, host, port, acceptor)

    server, client = bridge.both()
    thief = UdpThief(bridge.port)
    replaced.UDP_LISTEN.set(monkeypatch, bind_late)
    restart_in_vain(server, thief)
    eventually(lambda: not linked(client) and not linked(server))
    holds(lambda: not linked(client) and not linked(server), 3.0)
    thief.give_back()
    eventually(lambda: linked(client) and linked(server))


def test_a_server_that_is_stopped_tries_no_more(bridge: Bridge, thief: Thief) -> None:
    server, client = bridge.both()
    restart_in_vain(server, thief)
    began = time.monotonic()
    server.stop()
    assert time.monotonic() - began < STOPS_WITHIN
    thief.give_back()
    eventually(lambda: not linked(client))
    holds(lambda: not linked(client), 2.0)


def test_another_restart_takes_the_place_of_the_attempts(bridge: Bridge, thief: Thief) -> None:
    server, client = bridge.both()
    restart_in_vain(server, thief)
    thief.give_back()
    server.restart().result(60)
    eventually(lambda: linked(client) and linked(server))
    holds(lambda: linked(client) and linked(server), 2.0)


def test_two_restarts_at_once_are_one(bridge: Bridge) -> None:
    server, client = bridge.both()
    others: list[Future[None]] = []

    def restart_meanwhile(_: str) -> None:
        if not others:
            others.append(server.restart())

    server.restart(restart_meanwhile).result(60)
    with pytest.raises(EngineError, match=pattern(Denied.RESTARTING)):
        others[0].result(60)
    eventually(lambda: linked(client) and linked(server))  # the server knows first
