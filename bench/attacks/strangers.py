"""Attackers without a key, or with what they recorded of somebody who has one."""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import struct
import threading
import time
from collections import deque
from itertools import count
from typing import TYPE_CHECKING

from bench.attacks.target import Attack, paced
from tests.support.rogue import Rogue

from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.datagram import DatagramReader, Probe
from rsb_bridge.wire.messages import Accept, Describe, Hello, Ping, Propose, Ready
from rsb_bridge.wire.sealing import PROBE_ROUTE, CipherSuite

if TYPE_CHECKING:
    from collections.abc import Callable

    from bench.attacks.target import Tally, Target

KEPT = 200
"""Connections that an attacker keeps open, so that its own descriptors last."""
FLOW = "/flow"
"""A topic of the server's domain that flows at 4 MB/s."""
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close with a RST


def _connections(
    target: Target, tally: Tally, hz: float, sent: Callable[[int], bytes], source: Callable[[], str]
) -> None:
    """Connect so many times a second, say something, and keep the newest of the connections."""
    kept: deque[socket.socket] = deque()
    family = socket.AF_INET6 if ":" in target.host else socket.AF_INET
    for number in paced(hz):
        sock = socket.socket(family)
        # A full backlog must not stop the attack.
        sock.settimeout(1.0)
        try:
            sock.bind((source(), 0))
            sock.connect(target.address)
            sock.sendall(sent(number))
            tally["connections"] += 1
        except OSError:
            tally["connections that failed"] += 1
        kept.append(sock)
        if len(kept) > KEPT:
            kept.popleft().close()


def _anybody() -> str:
    return ""


def bare(target: Target, tally: Tally) -> None:
    _connections(target, tally, 500, lambda _: b"", _anybody)


def half_open(target: Target, tally: Tally) -> None:
    _connections(target, tally, 500, lambda _: struct.pack(">I", 200) + b"rsb\x01\x01\x01", _anybody)


def rubbish(target: Target, tally: Tally) -> None:
    _connections(target, tally, 50, _rubbish, _anybody)


def one_network(target: Target, tally: Tally) -> None:
    """From any address of an IPv6 /64, which one machine can have."""
    _connections(
        target, tally, 500, lambda _: b"",
        lambda: f"fd00:1:0:0:{random.getrandbits(16):x}:{random.getrandbits(16):x}:{random.getrandbits(16):x}:1",
    )  # fmt: skip


def _rubbish(number: int) -> bytes:
    match number % 4:
        case 0:
            return os.urandom(100)
        case 1:
            return b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n"
        case 2:
            return ClientConnection(Hello("1", "robot1", "x", 0), os.urandom(32), CipherSuite.AESGCM).start()
        case _:
            return ClientConnection(Hello("1", f"robot{number}", "x", 0), os.urandom(32), CipherSuite.AESGCM).start()


def replay(target: Target, tally: Tally) -> None:
    """Replay recorded first messages, some of which reached the server before, each followed by 1 MiB."""
    kept: deque[socket.socket] = deque()
    recorded = b""
    for number in paced(40):
        if number % 2 == 0:
            recorded = ClientConnection(Hello("1", "rogue", "rogue", 0), target.key, CipherSuite.AESGCM).start()
        with contextlib.suppress(OSError):
            sock = socket.create_connection(target.address, timeout=0.05)  # refusals may come late
            kept.append(sock)
            sock.sendall(recorded)
            tally["first messages"] += 1
            answer = sock.recv(4096)
            # This byte is the kind of a preamble frame; 3 is ACCEPT.
            tally["accepted" if answer[8:9] == b"\x03" else "refused"] += 1
            sock.setblocking(False)
            tally["bytes behind"] += sock.send(struct.pack(">I", 1 << 20) + bytes((1 << 20) - 1))
        if len(kept) > KEPT:
            kept.popleft().close()


def slow(target: Target, tally: Tally) -> None:
    """Hold twice as many connections as the server keeps, from eight hosts, with a byte of a preamble just in time."""
    said = struct.pack(">I", 4000) + b"rsb\x01\x01\x01\x06robot1" + bytes(3000)
    talking: dict[socket.socket, int] = {}
    hosts = [f"127.0.2.{number}" for number in range(1, 8)] + ["127.0.0.1"]
    for number in count():
        while len(talking) < len(hosts) * 64:
            sock = socket.socket()
            sock.settimeout(1.0)
            sock.bind((hosts[(number + len(talking)) % len(hosts)], 0))
            with contextlib.suppress(OSError):
                sock.connect(target.address)
            sock.setblocking(False)
            talking[sock] = 0
            tally["connections"] += 1
        for sock, at in tuple(talking.items()):
            try:
                sock.send(said[at : at + 1])
                talking[sock] = at + 1
                tally["bytes"] += 1
                # All that the server may say before a proof is a refusal.
                if select.select([sock], [], [], 0)[0]:
                    raise ConnectionError
            except OSError:
                sock.close()
                del talking[sock]
        time.sleep(0.1)


def resets(target: Target, tally: Tally) -> None:
    for _ in paced(2000):
        with contextlib.suppress(OSError), socket.create_connection(target.address, timeout=1.0) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            tally["resets"] += 1


def forged_datagrams(target: Target, tally: Tally) -> None:
    """Forge datagrams with a link's id and routes, which any observer of its datagrams knows."""
    with (
        Rogue(target.port, target.key, "rogue", host=target.host) as victim,
        socket.socket(type=socket.SOCK_DGRAM) as udp,
    ):
        threading.Thread(target=victim.drain, daemon=True).start()
        header = struct.Struct(">BBHHI8sQIQ")
        body = os.urandom(1300)
        for number in paced(20_000):
            route = (0, 1, 77)[number % 3]
            forged = header.pack(0xB5, 0, 0, 1, route, victim.keys.link_id, number, number % 2**32, 0) + body
            with contextlib.suppress(OSError):
                udp.sendto(forged, target.address)
                tally["datagrams"] += 1


class _Victim:
    """A client whose topic flows to it by UDP."""

    def __init__(self, target: Target) -> None:
        self.rogue = rogue = Rogue(target.port, target.key, "rogue", host=target.host)
        self.route = rogue.new_route()
        rogue.say(
            Propose(
                route=self.route,
                topic=FLOW,
                remote_topic="/not_here",
                from_client=False,
                transport="udp",
                type="std_msgs/msg/String",
            )
        )
        rogue.wait_for(Accept)
        rogue.wait_for(Describe)
        rogue.say(Ready(self.route, 1))
        threading.Thread(target=rogue.drain, daemon=True).start()
        self._reader = DatagramReader(rogue.keys.datagram_opener(PROBE_ROUTE, "server"), PROBE_ROUTE)

    def probe(self, probe: Probe) -> bytes:
        return self.rogue.probes.write(probe.pack(), 0, 0, 1400)[0]

    def answer(self, datagram: bytes) -> bytes | None:
        """Return the pong that the server expects, or None if the datagram is no challenge."""
        message = self._reader.receive(datagram, time.monotonic())
        asked = Probe.unpack(message[0]) if message is not None else None
        return self.probe(Probe(pong=True, opaque=asked.opaque)) if asked is not None and not asked.pong else None


def captured_probe(target: Target, tally: Tally) -> None:
    """Deliver each probe from elsewhere first, for 3 s; then the client answers for 3 s; then it falls silent."""
    victim = _Victim(target)
    with socket.socket(type=socket.SOCK_DGRAM) as third, socket.socket(type=socket.SOCK_DGRAM) as own:
        third.bind(("127.0.0.9", 0))
        for sock in (third, own):
            sock.connect(target.address)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        began = time.monotonic()
        probed = pinged = 0.0
        while True:
            now = time.monotonic() - began
            if now - probed > 0.25 and now < 6.0:
                probed = now
                captured = victim.probe(Probe(pong=False, opaque=0))
                third.send(captured)
                tally["captured probes"] += 1
                tally["bytes of them"] += len(captured)
                if now > 3.0:
                    own.send(victim.probe(Probe(pong=False, opaque=0)))
            if now - pinged > 1.0:
                pinged = now
                victim.rogue.say(Ping(1, 0))
            for sock in select.select([third, own], [], [], 0.05)[0]:
                data = sock.recv(65_535)
                if sock is third:
                    tally["bytes to the third party"] += len(data)
                    continue
                tally["kB to the client" if now < 6.0 else f"kB to it when silent for {int(now - 6.0)} s"] += (
                    len(data) // 1000
                )
                if now < 6.0 and (answer := victim.answer(data)) is not None:
                    own.send(answer)


ATTACKS = {
    "bare": Attack(bare, "500 connections/s that say nothing, from the robot's address", {"connections": 1000}),
    "half-open": Attack(half_open, "500 connections/s that begin a preamble", {"connections": 1000}),
    "rubbish": Attack(rubbish, "50 connections/s that speak rubbish, or have wrong keys", {"connections": 100}),
    "replay": Attack(replay, "40 recorded first messages/s, 1 MiB behind each", {"first messages": 60, "accepted": 4}),
    "slow": Attack(slow, "512 connections from eight hosts that say a byte each 0.1 s", {"bytes": 1000}),
    "resets": Attack(resets, "2,000 connections/s, each reset at once", {"resets": 2000}),
    "one-network": Attack(one_network, "500 connections/s from addresses of one IPv6 /64", {"connections": 1000}),
    "captured-probe": Attack(
        captured_probe,
        "a client's UDP probes, delivered first from elsewhere; then it falls silent",
        {"captured probes": 10},
        protocol="udp",
        seconds=16.0,
        stage="flow",
    ),
    "forged-datagrams": Attack(
        forged_datagrams, "20,000 datagrams/s with a link's id and wrong tags", {"datagrams": 20_000}, protocol="udp"
    ),
}
