"""Measures the cost of one peer's long control messages for all other links: CPU time of the loop's longest callback.

``python -m bench.control_messages [REPEATS]``. A server without ROS has a link to a peer, which sends each message; the
loop's callbacks are measured on their thread, so that other load on the machine counts little. The first line is
the loop's own need with a ping: the ratio is to that.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
from tests.support.ports import free_port
from tests.support.rogue import Rogue

from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.session import Client, Session
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.benchmark import BENCH

if TYPE_CHECKING:
    from collections.abc import Iterator

_LIMIT = CONTROL_LIMIT - 100
_SETTLES = 4.0


class _Ros(NoRos):
    """Takes the bridge's own announcements, and nothing comes of them."""

    gid = b"0123456789abcdef"
    lost = subscriber_count = 0
    acknowledged = True

    def subscribe(self, *_: object, **__: object) -> Any:
        return self

    advertise = subscribe

    def publish(self, payload: bytes) -> None:
        """Drop it."""

    def close(self) -> None:
        """Do nothing."""


class _Longest:
    """Measures the callbacks of the loop's thread."""

    most: ClassVar[float] = 0.0
    in_all: ClassVar[float] = 0.0

    @classmethod
    def watch(cls) -> None:
        """Measure all callbacks from now on."""
        run = asyncio.Handle._run

        def measured(handle: asyncio.Handle) -> None:
            # The engine's loop runs on a thread of its own; the main thread is this program's.
            if threading.current_thread() is threading.main_thread():
                run(handle)
                return
            began = time.thread_time()
            run(handle)
            took = time.thread_time() - began
            cls.most, cls.in_all = max(cls.most, took), cls.in_all + took

        asyncio.Handle._run = measured  # type: ignore[assignment, method-assign]

    @classmethod
    def reset(cls) -> None:
        cls.most = cls.in_all = 0.0


def messages(route: int) -> Iterator[tuple[str, bytes]]:
    def message(kind: str, **fields: Any) -> bytes:
        return msgspec.msgpack.encode({"message": kind, **fields})

    def many(entry: dict[str, Any], size: int = _LIMIT, most: int = 1 << 20) -> list[dict[str, Any]]:
        return [entry] * min(most, (size - 100) // len(msgspec.msgpack.encode(entry)))

    yield "ping", message("ping", n=1, sent=1)
    dropped = {"route": route, "dropped": {f"cause_{number:04}": number for number in range(32)}}
    yield "report, 1,000 entries of 400 B", message("report", sent=[], received=many(dropped, most=1000))
    short = {"route": route}
    yield "report, 1,000 short entries", message("report", sent=[], received=many(short, most=1000))
    yield "report, 400 kB of short entries", message("report", sent=[], received=many(short, 400_000))
    yield "report, 1 MiB of short entries", message("report", sent=[], received=many(short))
    yield "report, 400 kB of the sender's", message("report", sent=many(short, 400_000), received=[])
    yield "report, 1,000 of the sender's", message("report", sent=many(short, most=1000), received=[])
    nodes = {"route": route, "nodes": ["/"] * 16}
    yield "report, 1 MiB of node names", message("report", sent=many(nodes), received=[])
    topic = {"topic": "", "type": "", "type_hash": "", "qos": None, "publishers": 0, "subscriptions": 0}
    yield "topic list, 1 MiB, nobody asked", message("topiclist", request=1, topics=many(topic))
    yield "followed, 2,000 names", message("followed", request=1, present=many({"name": "/a"}, most=1000),
                                           gone=many({"name": "/b"}, most=1000))  # fmt: skip
    yield "publishers, 4,096", message("publishers", route=route, present=[n.to_bytes(16) for n in range(4096)])
    yield (
        "ready, 4,096 numbers",
        message("ready", route=route, sources=1, newest={n.to_bytes(16): n for n in range(4096)}),
    )
    yield "unknown field, 1 MiB nested", message("ping", n=1, sent=1, x=[[[]]] * (_LIMIT // 3))


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    _Longest.watch()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        key, port = write_key(folder / "k.key").secret, free_port()
        clients = (Client("robot1", "k.key", features={LIMITS.name: BenchmarkLimits()}),)
        server = Engine(
            Session(
                name="pc", role="server", server_ip="127.0.0.1", server_port=port, shutdown_topic=None, clients=clients
            ),
            base=folder,
            ros=_Ros(),
        )
        server.start()
        try:
            print("| message | bytes | longest turn, ms | in all, ms | ratio |\n|---|---|---|---|---|")
            base = 0.0
            # A message is chosen by its number, since it names a route, and each link has another one.
            for number in range(len(list(messages(1)))):
                most, in_all, size, text = 0.0, 0.0, 0, ""
                for _ in range(repeats):
                    with Rogue(port, key) as rogue:
                        route = rogue.internal(BENCH, ("tcp", "transmit"), "tcp")
                        text, content = list(messages(route))[number]
                        size = len(content)
                        time.sleep(0.3)
                        _Longest.reset()
                        rogue.say_raw(content)
                        rogue.drain_for(_SETTLES)
                        most, in_all = max(most, _Longest.most), max(in_all, _Longest.in_all)
                base = base or most
                print(f"| {text} | {size:,} | {1e3 * most:.1f} | {1e3 * in_all:.1f} | {most / base:.0f} |", flush=True)
        finally:
            server.stop()


if __name__ == "__main__":
    main()
