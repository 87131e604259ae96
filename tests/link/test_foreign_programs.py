"""Other programs at the ports of a link, and networks that swallow packets: both sides name the cause."""

from __future__ import annotations

import contextlib
import http.server
import socket
import threading
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.bridge import link, linked, now
from tests.support.waiting import eventually

from rsb_bridge.link.pending_connections import Rejected
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.wire.preamble import recognise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


def caused(engine: Engine, cause: LinkCause) -> bool:
    return any(event.cause == cause for event in engine.events())


@contextlib.contextmanager
def answering(port: int, answer: bytes) -> Iterator[None]:
    """A program that answers the first bytes that come."""
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError):
                connection, _ = listener.accept()
                with connection:
                    connection.recv(4096)
                    connection.sendall(answer)
                    connection.settimeout(5)
                    connection.recv(4096)

    with socket.create_server(("127.0.0.1", port)) as listener:
        listener.settimeout(0.2)
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize(
    ("data", "protocol"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "HTTP"),
        (b"<!DOCTYPE html>", "HTTP"),
        (b"GET / HTTP/1.1\r\n", "HTTP"),
        (b"GET ", "HTTP"),
        (b"SSH-2.0-OpenSSH_9.2p1\r\n", "SSH"),
        (b"\x16\x03\x01\x02\x00\x01", "TLS"),
        (b"\x15\x03\x03\x00\x02\x02\x46", "TLS"),
        (b"RTPS\x02\x03", "RTPS"),
        (bytes.fromhex("02000302"), "Zenoh"),  # a router, to whom an rsb-console spoke
        (bytes.fromhex("2000c109f22e9552"), "Zenoh"),  # a client
        (b"\x00\x00\x10\x01", ""),
        (b"\xff\xff\xff\xff", ""),
    ],
)
def test_first_bytes(data: bytes, protocol: str) -> None:
    assert recognise(data) == protocol


def test_another_program_at_the_servers_port(bridge: Bridge) -> None:
    with answering(bridge.port, b"SSH-2.0-x\r\n"):
        client = bridge.client()
        eventually(lambda: link(client).cause == LinkCause.NOT_A_BRIDGE)
        assert caused(client, LinkCause.NOT_A_BRIDGE)
        assert "SSH" in link(client).reason
        (event,) = [each for each in client.events() if each.cause == LinkCause.NOT_A_BRIDGE][:1]
        assert event.text.count(f":{bridge.port}") == 1, "the address is there once"
    server = bridge.server()
    client.retry().result(60)
    eventually(lambda: linked(server))


def test_web_server_that_waits_for_end_of_line(bridge: Bridge) -> None:
    """It says what it is only when it gets an empty line."""
    with http.server.ThreadingHTTPServer(("127.0.0.1", bridge.port), http.server.SimpleHTTPRequestHandler) as web:
        thread = threading.Thread(target=web.serve_forever)
        thread.start()
        try:
            client = bridge.client()
            # A busy web server may answer a later attempt only.
            found = eventually(lambda: seen if (seen := link(client)).cause == LinkCause.NOT_A_BRIDGE else None)
            assert "HTTP" in found.reason
        finally:
            web.shutdown()
            thread.join()


def test_a_network_that_swallows_packets(bridge: Bridge) -> None:
    """A full backlog drops SYN packets as a firewall does."""
    with contextlib.ExitStack() as sockets:
        silent = sockets.enter_context(socket.socket())
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        silent.bind(("127.0.0.1", bridge.port))
        silent.listen(0)
        for _ in range(4):
            waiting = sockets.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(("127.0.0.1", bridge.port))
        client = bridge.client()
        eventually(lambda: link(client).attempts)
        assert link(client).cause == LinkCause.TIMED_OUT


def test_packets_that_vanish_while_linked(bridge: Bridge, relay: Relay) -> None:
    server, client = bridge.both()
    relay.stall(new=True)
    for engine in (server, client):
        eventually(lambda engine=engine: caused(engine, LinkCause.SILENT))
    eventually(lambda: link(server).cause == LinkCause.SILENT)
    eventually(lambda: link(client).cause == LinkCause.NO_ANSWER)  # the relay accepts, and carries nothing
    relay.stall(stalled=False)
    eventually(lambda: linked(server) and linked(client))


@pytest.mark.parametrize(
    ("sent", "cause", "text"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", LinkCause.NOT_A_BRIDGE, ""),
        (b"", LinkCause.NO_ANSWER, Rejected.SENT_NOTHING(seconds=0.3)),
    ],
)
def test_another_program_that_connects_to_the_server(
    sent: bytes, cause: LinkCause, text: str, bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line reports it, however often it connects."""
    constants.SERVER_HANDSHAKE_WITHIN.set(monkeypatch, 60.0 if sent else 0.3)  # who speaks may do so late
    server = bridge.server()
    for _ in range(4):
        with socket.create_connection(("127.0.0.1", bridge.port), timeout=180) as stranger:
            stranger.sendall(sent)
            while stranger.recv(4096):
                pass
    rejected = [event for event in server.events() if event.code == EventCode.LINK_REJECTED]
    assert [event.cause for event in rejected] == [cause]
    assert text in rejected[0].text
    assert not now(server).refused
