"""Memory of a server that strangers flood: ``python -m bench.strangers [--short] [TRANSPORT ...]`` prints a table.

Strangers have no key. Each row is a new server with a robot that links, is ended and links again during the flood: its
topic has to flow. The memory is the server's resident memory (MB): before, the most during the flood, and after it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import socket
import struct
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bench import bed

from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.sealing import CipherSuite
from rsb_extras.bench import loopback
from rsb_extras.bench.results import BenchError
from rsb_extras.demo import processes
from rsb_extras.zenoh.endpoint import ROOT
from rsb_extras.zenoh.sample_header import Header, SampleKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rsb_extras.demo.processes import Process

FLAT = 10.0
"""MB by which the memory may grow. At most 6 were measured (bench/README.md, Attacks)."""
HZ, SIZE = 50, 1000
"""The robot's topic during a flood."""
_KEPT = 400
"""Connections that the flood keeps open."""
_LINKED_WITHIN = 20.0
_SETTLES = 4.0
_TYPE = "std_msgs/msg/String"
_ZENOH = "zenoh"


class Flood(NamedTuple):
    """A kind of flood.

    Attributes:
        transport: ``tcp``, ``udp`` or ``zenoh``.
        rate: connections, datagrams or first samples a second.
        size: bytes of each.
        many: whether they come from many addresses.
    """

    transport: str
    rate: int
    size: int
    many: bool
    seconds: float = 20.0


FLOODS = (
    Flood("tcp", 100, 120_000, many=False),
    Flood("tcp", 600, 250_000, many=True),
    Flood("tcp", 600, 4_000, many=False),
    Flood("tcp", 600, 4_000, many=True),
    Flood("udp", 20_000, 1_400, many=False),
    Flood("udp", 1_000, 60_000, many=False),
    Flood("udp", 1_000, 60_000, many=True),
    Flood("zenoh", 100, 1_000_000, many=False),
    Flood("zenoh", 100, 1_000_000, many=True),
    Flood("zenoh", 1_000, 60_000, many=True),
    Flood("zenoh", 1_000, 4_000, many=False),
    Flood("zenoh", 1_000, 4_000, many=True),
    Flood("zenoh", 20_000, 100, many=True),
)
SHORT = (
    Flood("tcp", 300, 120_000, many=True, seconds=6.0),
    Flood("udp", 500, 60_000, many=True, seconds=6.0),
    Flood("zenoh", 100, 1_000_000, many=True, seconds=6.0),
)
"""One for each transport."""


class Row(NamedTuple):
    """The effect of a flood.

    Attributes:
        sent: number of connections, datagrams or samples.
        before: memory (MB) before the flood.
        peak: the most during it.
        after: some seconds after it.
        linked: s from the start of the robot's process to its first message, or None if none came.
        delivered: the share of the robot's messages during the flood.
    """

    sent: int
    before: float
    peak: float
    after: float
    linked: float | None
    delivered: float

    @property
    def flat(self) -> bool:
        """Whether the memory stayed as it was, and the robot was served."""
        return max(self.peak, self.after) - self.before <= FLAT and self.linked is not None


# --- the server and its robot


class Stage:
    """A server, a robot that comes and goes, and a topic between them."""

    def __init__(self, resources: contextlib.ExitStack, transport: str, near: int, far: int) -> None:
        self._folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="rsb-bench-")))
        entry = f"  - {{topic: {loopback.TOPIC}, direction: transmit, type: {_TYPE}, qos: 2000"
        entries = [f"{entry}, protocol: {transport}}}"]
        zenoh: loopback.ZenohPath = "router" if transport == _ZENOH else ""
        self.port = loopback.write_sessions(self._folder, near, far, entries, zenoh)
        if zenoh:
            resources.enter_context(processes.router(f"tcp/127.0.0.1:{self.port}"))
        self._bed = resources.enter_context(loopback.ends(near, far))
        self.server = resources.enter_context(loopback.headless(self._folder / "server.yaml"))

    @contextlib.contextmanager
    def robot(self) -> Iterator[float | None]:
        """Run the robot's process; return the seconds until its first message, or None if no message came in time."""
        began = time.monotonic()
        with loopback.headless(self._folder / "client.yaml"):
            self._bed.listener.ask("reset")
            while not self._bed.listener.ask("count")["count"]:
                if time.monotonic() - began > _LINKED_WITHIN:
                    yield None
                    return
                self._bed.talker.ask("send 100 2 100")
                time.sleep(0.05)
            yield time.monotonic() - began

    def send(self, seconds: float) -> float:
        """Have the robot send for a while; the share that came."""
        run = self._bed.send(HZ, seconds, SIZE)
        return min(1.0, run.received / run.sent)

    @property
    def log(self) -> str:
        return (self._folder / "server.log").read_text(errors="replace")


class _Watch:
    """Samples a process's memory until it is asked for the most."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._most = process.memory()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._sample)
        self._thread.start()

    def _sample(self) -> None:
        with contextlib.suppress(OSError, IndexError):  # it has ended
            while not self._over.wait(0.05):
                self._most = max(self._most, self._process.memory())

    def most(self) -> float:
        self._over.set()
        self._thread.join()
        return self._most


def measure(flood: Flood, near: int = bed.NEAR, far: int = bed.FAR) -> Row:
    """Flood a new server.

    Raises:
        BenchError: the robot does not link without a flood, or the server has ended.
    """
    with contextlib.ExitStack() as resources:
        stage = Stage(resources, flood.transport, near, far)
        for _ in range(2):  # the first time loads what the second one has
            with stage.robot() as linked:
                if linked is None:
                    raise BenchError(f"the robot does not link over {flood.transport}: {stage.log[-2000:]}")
                stage.send(1.0)
        time.sleep(1.0)
        before = stage.server.memory()
        watch = _Watch(stage.server)
        with bed.Process("-m", "bench.strangers", "--flood", json.dumps((*flood, stage.port))) as flooding:
            flooding.line()  # it has begun
            began = time.monotonic()
            with stage.robot() as linked:
                rest = max(2.0, flood.seconds - (time.monotonic() - began))
                delivered = stage.send(rest) if linked is not None else 0.0
            sent = int(flooding.ask("tally")["sent"])
        peak = watch.most()
        time.sleep(_SETTLES)
        if not stage.server.running:
            raise BenchError(f"the server has ended: {stage.log[-2000:]}")
        return Row(sent, before, peak, stage.server.memory(), linked, delivered)


# --- the strangers


def _paced(hz: float) -> Iterator[int]:
    began, number = time.monotonic(), 0
    while True:
        yield number
        number += 1
        if (ahead := began + number / hz - time.monotonic()) > 0.001:
            time.sleep(ahead)


def _address(flood: Flood) -> str:
    """Return an address of this machine to send from."""
    if not flood.many:
        return "127.0.0.1"
    return f"127.{random.randrange(1, 255)}.{random.randrange(255)}.{random.randrange(1, 255)}"


def _said(number: int, size: int) -> bytes:
    """Return one stranger's bytes: an unfinished frame, a first message with a wrong key, or noise; then zeros."""
    match number % 3:
        case 0:
            begun = struct.pack(">I", 4096) + b"rsb\x01\x01"
        case 1:
            begun = ClientConnection(Hello("1", "bench", "x", 0), os.urandom(32), CipherSuite.AESGCM).start()
        case _:
            begun = os.urandom(100)
    return begun[:size] + bytes(max(0, size - len(begun)))


def _tcp(flood: Flood, port: int, tally: Counter[str]) -> None:
    kept: deque[socket.socket] = deque()
    for number in _paced(flood.rate):
        sock = socket.socket()
        kept.append(sock)
        sock.settimeout(0.2)
        with contextlib.suppress(OSError):
            sock.bind((_address(flood), 0))
            sock.connect(("127.0.0.1", port))
            sock.setblocking(False)
            sock.send(_said(number, flood.size))
            tally["sent"] += 1
        if len(kept) > _KEPT:
            kept.popleft().close()


def _udp(flood: Flood, port: int, tally: Counter[str]) -> None:
    sockets = [socket.socket(type=socket.SOCK_DGRAM) for _ in range(200 if flood.many else 1)]
    for sock in sockets:
        sock.bind((_address(flood), 0))
    header = struct.Struct(">BBHHI8sQIQ")
    body = bytes(flood.size - header.size)
    for number in _paced(flood.rate):
        link_id = os.urandom(8)
        with contextlib.suppress(OSError):
            sent = header.pack(0xB5, 0, 0, 2, number % 5, link_id, number, number, 0) + body
            sockets[number % len(sockets)].sendto(sent, ("127.0.0.1", port))
            tally["sent"] += 1


def _zenoh(flood: Flood, port: int, tally: Counter[str]) -> None:
    import zenoh  # noqa: PLC0415 (an extra)

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    replies = session.liveliness().get(f"{ROOT}/*/here/server/*/*")
    _, fleet, _, _, server, _ = next(str(reply.ok.key_expr) for reply in replies if reply.ok is not None).split("/")
    attachment = Header(SampleKind.DATA, 1, 0).pack()
    for number in _paced(flood.rate):
        sender = os.urandom(8).hex() if flood.many else "f" * 16
        session.put(
            f"{ROOT}/{fleet}/at/{server}/{sender}/{os.urandom(8).hex()}",
            _said(number, flood.size),
            attachment=attachment,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        tally["sent"] += 1


_BY: dict[str, Callable[[Flood, int, Counter[str]], None]] = {"tcp": _tcp, "udp": _udp, _ZENOH: _zenoh}


def _flood(text: str) -> None:
    """Be the strangers: a line asks for the tally."""
    *fields, port = json.loads(text)
    flood, tally = Flood(*fields), Counter[str](sent=0)
    threading.Thread(target=_BY[flood.transport], args=(flood, port, tally), daemon=True).start()
    while not tally["sent"]:
        time.sleep(0.01)
    print("begun", flush=True)
    for _ in sys.stdin:
        print(json.dumps(dict(tally)), flush=True)
    os._exit(0)


# --- the table


def table(floods: Iterable[Flood]) -> Iterator[tuple[str, Row]]:
    """Return the rows of the table with their figures."""
    for flood in floods:
        row = measure(flood)
        linked = "never" if row.linked is None else f"{row.linked:.1f}"
        text = (
            f"| {flood.transport} | {flood.rate:,} | {flood.size:,} | {'many' if flood.many else 'one'} | {row.sent:,} "
            f"| {row.before:.0f} | {row.peak:.0f} | {row.after:.0f} | {linked} | {row.delivered:.2f} |"
        )
        yield text, row


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.strangers", description=__doc__)
    parser.add_argument("transports", nargs="*", help="only these: tcp, udp, zenoh")
    parser.add_argument("--short", action="store_true", help="one short row for each transport")
    parser.add_argument("--flood", help=argparse.SUPPRESS)
    parsed = parser.parse_args(arguments)
    if parsed.flood:
        _flood(parsed.flood)
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what runs is ended first
    print("| transport | rate, 1/s | size, B | addresses | sent | before, MB | peak | after | linked, s | delivered |")
    print("|---" * 10 + "|", flush=True)
    flat = True
    for text, row in table(each for each in (SHORT if parsed.short else FLOODS)
                           if not parsed.transports or each.transport in parsed.transports):  # fmt: skip
        print(text, flush=True)
        flat = flat and row.flat
    return 0 if flat else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
