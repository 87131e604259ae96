"""Two UDP channels without ROS, in two processes: ``python -m bench.udp_channels [--buffer BYTES] [RATE:SIZE ...]``.

Prints the share delivered, the CPU of each side, and the time from a message's turn to its arrival. With ``--buffer``
the receiver requests a kernel buffer of that many bytes, as if its kernel allowed no more.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tests.support.acceptors import Accepting

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram_channel import DatagramSender
from rsb_bridge.channel.reliable_datagrams import datagram_channel
from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.udp_channel import ClientUdpChannel, PathProbe, ServerUdpChannel, UdpDemultiplexer
from rsb_bridge.channel.window import ReceiptBook, Window
from rsb_bridge.model.fates import RELIABLE
from rsb_bridge.route.sending import QueueLimits, SendQueue
from rsb_bridge.transport import udp
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.fates import Fates
    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.messages import Receipts
    from rsb_bridge.wire.sealing import Role

_HOST = "127.0.0.1"
_LINK = b"the link"
_LOADS = ((10_000, 2_500), (30_000, 2_500), (1_000, 100_000), (3_000, 100_000))
_LARGE = ((100, 1_000_000), (250, 1_000_000), (30, 6_000_000))
_SECONDS = 2.0
_QUEUE = QueueLimits(2000, 0.0, 40 * 1024 * 1024)


@dataclass
class Route:
    """A route's end (`RouteSink`): a queue, or the latencies (ns) of what has come."""

    outgoing: bool
    id: int = 1
    duplex: bool = False
    fates: Fates = field(default_factory=lambda: RELIABLE)
    weight: int = 4
    latencies: list[int] = field(default_factory=list)
    queue: SendQueue = field(default_factory=lambda: SendQueue(Budget(1 << 40)))
    sender: DatagramSender | None = None

    def deliver(self, messages: Iterable[Message]) -> None:
        self.latencies += [time.monotonic_ns() - stamp for _, stamp, _ in messages]

    def flush(self) -> None:
        while self.queue and self.sender is not None and not self.sender.congested:
            self.sender.send(self.queue.take(16, self.sender.batch_bytes))
        if self.queue and self.sender is not None:
            self.sender.ask()

    def channel_lost(self, reason: Reason) -> None:
        raise SystemExit(reason.text)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.udp_channels")
    parser.add_argument("--buffer", type=int, default=0)
    parser.add_argument("--receive", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("loads", nargs="*")
    options = parser.parse_args()
    if options.receive:
        asyncio.run(_receive(options.buffer))
        return
    print("    Hz     bytes delivered  send, us  receive, us  p50, ms  p99, ms")
    for rate, size in [tuple(map(int, each.split(":"))) for each in options.loads] or [*_LOADS, *_LARGE]:
        command = [sys.executable, "-m", "bench.udp_channels", "--receive", "--buffer", str(options.buffer)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as receiver:
            assert receiver.stdout is not None
            cpu, sent = asyncio.run(_send(int(receiver.stdout.readline()), rate, size))
            said = json.loads(receiver.communicate("\n")[0])
        print(
            f"{rate:6} {size:9} {said['count'] / sent:9.3f} {cpu / sent * 1e6:9.0f} {said['cpu'] / sent * 1e6:12.0f} "
            f"{said['p50'] / 1e6:8.2f} {said['p99'] / 1e6:8.2f}",
            flush=True,
        )


async def _send(port: int, rate: int, size: int) -> tuple[float, int]:
    """Send for a while; the CPU time (s) that it took, and how many messages they were."""
    keys = _keys("client")
    connection = Connection(keys)
    channel = ClientUdpChannel(connection, udp.Udp(), (_HOST, port))
    await connection.ready.wait()
    route = Route(outgoing=True)
    sender = datagram_channel(channel, route, keys)
    assert isinstance(sender, DatagramSender)
    route.sender = sender
    content, before, began, due = os.urandom(size), _cpu(), time.monotonic(), 0
    while due < rate * _SECONDS:
        newly = min(int((time.monotonic() - began) * rate) + 1, int(rate * _SECONDS)) - due
        due += newly
        route.queue.add([(content, time.monotonic_ns(), 0)] * newly, time.monotonic(), b"")
        route.queue.trim(_QUEUE, time.monotonic(), b"")
        route.flush()
        await asyncio.sleep(0.0005)
    while route.queue or sender.congested:  # noqa: ASYNC110 - plain state
        await asyncio.sleep(0.01)
    # The last messages have to arrive before the channel closes.
    await asyncio.sleep(0.5)
    channel.close()
    return _cpu() - before, due


async def _receive(buffer: int) -> None:
    """Receive until a line is read, and print the counts."""
    if buffer:
        vars(udp)["RECEIVE_BUFFER"] = buffer  # it asks the kernel for no more
    loop, route, over = asyncio.get_running_loop(), Route(outgoing=False), asyncio.Event()
    connection = Connection(_keys("server"), route)
    acceptor = Accepting(datagrams=UdpDemultiplexer(connection).received)
    bound = await udp.Udp().listen(_HOST, 0, acceptor)
    print(bound.sockets[0].port, flush=True)
    loop.add_reader(sys.stdin, over.set)
    before = _cpu()
    await over.wait()
    ordered = sorted(route.latencies) or [0]
    p50, p99 = ordered[len(ordered) // 2], ordered[len(ordered) * 99 // 100]
    print(json.dumps({"count": len(route.latencies), "cpu": _cpu() - before, "p50": p50, "p99": p99}))
    bound.close()


class Connection:
    """A connection with one UDP channel, which is also the only one of its server.

    Args:
        route: to receive, or None at the sending end.

    Attributes:
        ready: the channel has found its path.
    """

    def __init__(self, keys: DataKeys, route: Route | None = None) -> None:
        loop = asyncio.get_running_loop()
        self.now, self.ready, self.probe = loop.time, asyncio.Event(), PathProbe(keys)
        self.book = ReceiptBook(loop, self)
        self.scheduler = Scheduler(self.book, Window())
        self._keys, self._route = keys, route

    def new_udp_channel(self, link_id: bytes, socket: DatagramSocket, address: Address) -> ServerUdpChannel:
        assert self._route is not None
        channel = ServerUdpChannel(self, socket, _HOST)
        datagram_channel(channel, self._route, self._keys)
        return channel

    def udp_ready(self) -> None:
        self.ready.set()

    def take_urgent(self, content: bytes) -> None:
        """Nothing is urgent here."""

    def send_receipts(self, receipts: Receipts) -> None:
        """No byte has come on a stream."""

    def ping(self) -> float:
        return 0.0

    def way_back(self) -> float:
        return 0.0


def _keys(role: Role) -> DataKeys:
    keys = ConnectionKeys(CipherSuite.AESGCM, bytes(32), _LINK)
    keys.proposed(Route.id, "client")
    return DataKeys(keys, role, Budget(256 << 20))


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
