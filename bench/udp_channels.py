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

from rsb_bridge.channel.data_keys import DataKeys
from rsb_bridge.channel.datagram_channel import DatagramSender, datagram_channel
from rsb_bridge.channel.scheduler import Scheduler
from rsb_bridge.channel.udp_channel import ClientUdpChannel, PathProbe, ServerUdpChannel, UdpDemultiplexer
from rsb_bridge.channel.window import ReceiptBook, Window
from rsb_bridge.route.sending import QueueLimits, SendQueue
from rsb_bridge.transport import udp
from rsb_bridge.transport.streams import StreamHandler
from rsb_bridge.transport.transport import Acceptor
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.sealing import CipherSuite, SessionKeys

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.reason import Reason
    from rsb_bridge.transport.streams import Address
    from rsb_bridge.transport.transport import DatagramSocket
    from rsb_bridge.wire.framing import Message
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
    resumes: bool = True
    weight: int = 4
    latencies: list[int] = field(default_factory=list)
    queue: SendQueue = field(default_factory=SendQueue)
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
    loop, keys, ready = asyncio.get_running_loop(), _keys("client"), asyncio.Event()
    channel = ClientUdpChannel(udp.Udp(), (_HOST, port), PathProbe(keys), loop.time, ready.set)
    await ready.wait()
    route = Route(outgoing=True)
    sender = datagram_channel(channel, route, keys, _scheduler())
    assert isinstance(sender, DatagramSender)
    route.sender = sender
    content, before, began, due = os.urandom(size), _cpu(), time.monotonic(), 0
    while due < rate * _SECONDS:
        newly = min(int((time.monotonic() - began) * rate) + 1, int(rate * _SECONDS)) - due
        due += newly
        route.queue.add([(content, time.monotonic_ns(), 0)] * newly, time.monotonic())
        route.queue.trim(_QUEUE, time.monotonic())
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
    loop, keys, route, over = asyncio.get_running_loop(), _keys("server"), Route(outgoing=False), asyncio.Event()
    probe = PathProbe(keys)

    def new_channel(link_id: bytes, socket: DatagramSocket, _: Address) -> ServerUdpChannel:
        channel = ServerUdpChannel(socket, _HOST, probe, loop.time, lambda: None)
        datagram_channel(channel, route, keys, _scheduler())
        return channel

    acceptor = Acceptor(StreamHandler, UdpDemultiplexer(new_channel).received, print)
    bound = await udp.Udp().listen(_HOST, 0, acceptor)
    print(bound.sockets[0].port, flush=True)
    loop.add_reader(sys.stdin, over.set)
    before = _cpu()
    await over.wait()
    ordered = sorted(route.latencies) or [0]
    p50, p99 = ordered[len(ordered) // 2], ordered[len(ordered) * 99 // 100]
    print(json.dumps({"count": len(route.latencies), "cpu": _cpu() - before, "p50": p50, "p99": p99}))
    bound.close()


def _scheduler() -> Scheduler:
    return Scheduler(ReceiptBook(asyncio.get_running_loop(), lambda _: None), Window())


def _keys(role: Role) -> DataKeys:
    keys = SessionKeys(CipherSuite.AESGCM, bytes(32), _LINK)
    keys.proposed(Route.id, "client")
    return DataKeys(keys, role, Budget(256 << 20))


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
