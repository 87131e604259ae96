"""Measures how an association goes on after a reset: ``python -m bench.resume [TOPICS...] [--moves N]``.

Two bridges, each a process, carry topics of DDS in both directions, half of them each, through a relay that resets all
connections. Right after that, each topic publishes one message of 100 bytes. Printed are, as medians of five resets:
ms from the reset to the last topic's message, and the bytes in both directions until then. The same is printed without
a reset, and with `outlive` 0, where a new association begins, and a topic publishes every 20 ms until a message comes.

Then one pair of bridges is moved N times (1,000), with a message of each topic after each reset. Printed are memory,
descriptors, tasks and the objects of the program before and after, and how many endpoints of all topics have come or
gone in both domains.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import contextlib
import gc
import json
import os
import socket
import struct
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from bench import bed
from bench.quiet_side import wait_until_open
from tests.support.relay import Relay

from rsb_bridge.engine import Engine
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.wire import sealing

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Role

_TYPE = "std_msgs/msg/String"
_RESETS = 5
_MOVED_TOPICS = 20
_OPEN_WITHIN = 180.0
_CAME_WITHIN = 60.0
_REPEATS_AFTER = 0.02
_RESTS = 1.2
"""s between two measurements: a receipt, a ping and a report are each sent once a second."""
_LINGER = struct.pack("ii", 1, 0)
"""Of a socket that is reset when it is closed."""
_CONTENT = b"\0\1\0\0" + struct.pack("<I", 96) + bytes(95).replace(b"\0", b"x") + b"\0"


def main() -> None:
    match sys.argv[1:]:
        case ["side", role, folder, port, lasts, *names]:
            _side(cast("Role", role), folder, int(port), float(lasts), names)
            return
        case ["ends", *names]:
            _ends(names)
            return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("topics", nargs="*", type=int, default=[1, 100, 500])
    parser.add_argument("--moves", type=int, default=1000)
    options = parser.parse_args()
    print(f"{'topics':>8} {'':>16} {'ms':>8} {'bytes':>10} {'a topic':>8}")
    for count in options.topics:
        for outlive, name in ((60.0, "goes on"), (0.0, "new association")):
            with _bridged(count, outlive) as bridged:
                if outlive:
                    _row(count, "no reset", [bridged.measure(reset=False) for _ in range(_RESETS)])
                _row(count, name, [bridged.measure(reset=True, repeats=not outlive) for _ in range(_RESETS)])
    if options.moves:
        with _bridged(_MOVED_TOPICS, 60.0) as bridged:
            _move(bridged, options.moves)


def _row(topics: int, name: str, measured: Sequence[tuple[float, int]]) -> None:
    ms, carried = (median(each) for each in zip(*measured, strict=True))
    print(f"{topics:>8} {name:>16} {ms:>8.0f} {carried:>10,.0f} {carried / topics:>8,.0f}", flush=True)


class _Bridged(NamedTuple):
    relay: Relay
    sides: tuple[bed.Process, bed.Process]
    ends: bed.Process
    topics: int

    def measure(self, *, reset: bool, repeats: bool = False) -> tuple[float, int]:
        """Return the ms until the last topic's message came, and the bytes until then."""
        time.sleep(_RESTS)
        before, began = self._carried(), time.time_ns()
        if reset:
            self.reset()
        came = self.ends.ask("repeat" if repeats else "publish")
        if came["count"] != self.topics:
            raise SystemExit(f"only {came['count']} of {self.topics} messages came")
        return (came["last"] - began) / 1e6, self._carried() - before

    def reset(self) -> None:
        for connection in tuple(self.relay.connections):
            for end in (connection.near, connection.far):
                with contextlib.suppress(OSError):  # it has ended
                    if end is not None:
                        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER)
        self.relay.cut()

    def _carried(self) -> int:
        return sum(way.carried for way in self.relay.ways)


@contextlib.contextmanager
def _bridged(topics: int, outlive: float) -> Iterator[_Bridged]:
    names = [f"/resume/{'up' if number % 2 else 'down'}{number}" for number in range(topics)]
    port = bed.free_port()
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        key = Path(folder) / "bench.key"
        key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
        key.chmod(0o600)
        relay = stack.enter_context(Relay(("127.0.0.1", port)))
        ends = stack.enter_context(bed.Process("-m", "bench.resume", "ends", *names))
        ends.line()
        command = ("-m", "bench.resume", "side")
        sides = tuple(
            stack.enter_context(bed.Process(*command, role, folder, str(at), str(outlive), *listed))
            for role, at, listed in (("server", port, []), ("client", relay.port, names))
        )
        for side in sides:
            side.line()
        for side in sides:
            side.ask(f"open {topics}")
        bridged = _Bridged(relay, cast("tuple[bed.Process, bed.Process]", sides), ends, topics)
        bridged.measure(reset=False, repeats=True)  # not counted: DDS may be slow with the first messages
        yield bridged


def _move(bridged: _Bridged, moves: int) -> None:
    for _ in range(20):  # what is made once and kept
        _moved(bridged)
    before, endpoints = [_stand(side) for side in bridged.sides], _endpoints(bridged.ends)
    began = time.monotonic()
    slowest = max(_moved(bridged) for _ in range(moves))
    took = time.monotonic() - began
    changed = endpoints ^ _endpoints(bridged.ends)
    print(f"\n{moves:,} moves of {bridged.topics} topics in {took:.0f} s, the slowest {slowest:.1f} s;", end=" ")
    print(f"{len(changed)} of {len(endpoints)} endpoints came or went")
    for role, side, then in zip(("server", "client"), bridged.sides, before, strict=True):
        now = _stand(side)
        figures = ", ".join(f"{name} {then[name]:,} → {now[name]:,}" for name in ("kB", "descriptors", "tasks", "keys"))
        grown = Counter(now["objects"])
        grown.subtract(then["objects"])
        more = ", ".join(f"{name} +{count}" for name, count in grown.most_common(8) if count > 0)
        print(
            f"{role}: {figures}; objects {sum(then['objects'].values()):,} → {sum(now['objects'].values()):,} ({more})"
        )


def _stand(side: bed.Process) -> dict[str, Any]:
    return cast("dict[str, Any]", side.ask("stand"))


def _endpoints(ends: bed.Process) -> set[str]:
    return {*cast("dict[str, list[str]]", ends.ask("endpoints"))["ids"]}


def _moved(bridged: _Bridged) -> float:
    began = time.monotonic()
    bridged.reset()
    if bridged.ends.ask("publish")["count"] != bridged.topics:
        raise SystemExit("the link does not come back")
    return time.monotonic() - began


# --- processes


def _side(role: Role, folder: str, port: int, outlive: float, names: Sequence[str]) -> None:
    topics = tuple(Topic(name, "transmit" if "/up" in name else "receive", type=_TYPE) for name in names)
    domain = bed.NEAR if role == "client" else bed.FAR
    session = Session(
        name="bench", role=role, server_ip="127.0.0.1", server_port=port, key_file="bench.key", topics=topics,
        domain_id=domain, outlive=outlive,
    )  # fmt: skip
    engine = Engine(session, base=Path(folder), ros=RosNode(domain, role))
    engine.start()
    print("{}", flush=True)
    for line in sys.stdin:
        answer: dict[str, Any] = {}
        match line.split():
            case ["open", count]:
                wait_until_open(engine, int(count), _OPEN_WITHIN)
            case ["stand"]:
                answer = _standing(engine)
        print(json.dumps(answer), flush=True)


def _standing(engine: Engine) -> dict[str, Any]:
    time.sleep(2.0)  # what ends with a connection has ended
    assert engine._bridge is not None
    tasks: Future[int] = Future()
    engine._bridge.context.call(lambda: tasks.set_result(len(asyncio.all_tasks())))
    gc.collect()
    objects = Counter(type(each) for each in gc.get_objects())
    of_program = {kind.__qualname__: count for kind, count in objects.items() if "rsb_" in f"{kind.__module__}"}
    return {
        "kB": int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024,
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "tasks": tasks.result(10),
        "keys": sum(count for kind, count in objects.items() if kind.__module__ == sealing.__name__),
        "objects": of_program | {"all": sum(objects.values())},
    }


def _ends(names: Sequence[str]) -> None:
    """Publish and hear all topics, and answer once one message of each has come.

    With "publish" each topic publishes one, with "repeat" as many as it takes; "endpoints" are all that there are.
    """
    near, far = (RosNode(domain, f"ends{domain}") for domain in (bed.NEAR, bed.FAR))
    due: set[str] = set()
    changed = threading.Condition()
    last = 0

    def heard(name: str, _: object) -> None:
        nonlocal last
        with changed:
            if name in due:
                due.remove(name)
                last = time.time_ns()
                changed.notify()

    near.start()
    far.start()
    publishers = {}
    for name in names:
        begin, end = (near, far) if "/up" in name else (far, near)
        spec = TopicSpec(name, _TYPE, "", Qos())
        end.subscribe(spec, partial(heard, name), "ends")
        publishers[name] = begin.advertise(spec, "ends")
    print("{}", flush=True)
    for line in sys.stdin:
        if line.strip() == "endpoints":
            found = [each for node in (near, far) for name in names for each in node.publishers(name)]
            found += [each for node in (near, far) for name in names for each in node.subscriptions(name)]
            print(json.dumps({"ids": [each.gid.hex() for each in found]}), flush=True)
            continue
        with changed:
            due.update(names)
        deadline, repeats = time.monotonic() + _CAME_WITHIN, line.strip() == "repeat"
        while due and time.monotonic() < deadline:
            for name in tuple(due):
                publishers[name].publish(_CONTENT)
            with changed:
                changed.wait_for(lambda: not due, _REPEATS_AFTER if repeats else _CAME_WITHIN)
        print(json.dumps({"last": last, "count": len(names) - len(due)}), flush=True)


if __name__ == "__main__":
    main()
