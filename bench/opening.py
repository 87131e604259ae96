"""Prints how long a link's topics and services take to open: ``python -m bench.opening [topics]``.

Each side is a process of its own, and so are the publishers of the topics where ROS is real. Under ``stand-in`` there
is no ROS behind the engine: what the bridge itself takes. ``floor`` is what rclpy alone takes for one side's endpoints,
in a loop. The side that sends runs first, until DDS has found the publishers: its part is no bridge's.

Then 200 services of ten nodes: s from their start until a client sees them all, and calls to them.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bench import bed, calls
from tests.bluetooth.guest.stand_in import StandIn
from tests.support.calls import CallNode

from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import TopicSpec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Direction, Role
    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.ros.ros_interface import RosInterface

TOPICS = 500
_DISCOVERED_WITHIN = 60.0
_OPEN_WITHIN = 120.0
_TICK = 0.005
_NODES, _EACH = 10, 20
"""Nodes with services, and services of each."""
_TURN = 10
"""Calls of each service."""


def main() -> None:
    match sys.argv[1:]:
        case ["side", options]:
            _side(**json.loads(options))
        case ["publish", domain, *names]:
            _publish(int(domain), names)
        case ["floor", *names]:
            _floor(names)
        case []:
            report(TOPICS)
            _report_services()
        case [topics]:
            report(int(topics))
            _report_services()


def report(topics: int) -> None:
    """Measure and print; `topics` on one link."""
    names = [f"/bench/topic_{number}" for number in range(topics)]
    print(f"\n{topics} topics: s from the link to the last one open; the longest s that the I/O loop was late; CPU s")
    _row("", "opened", "errors", "late", "late there", "CPU")
    for ros in ("stand-in", "real"):
        for protocol in ("tcp", "udp"):
            for direction in ("transmit", "receive"):
                _measure(ros, protocol, direction, names)
    with bed.Process("-m", "bench.opening", "publish", str(bed.NEAR), *names) as publishers:
        publishers.line()
        with bed.Process("-m", "bench.opening", "floor", *names) as endpoints:
            took = json.loads(endpoints.line())
            _row("floor: subscriptions", f"{took['subscriptions']:.2f}")
            _row("floor: publishers", f"{took['publishers']:.2f}")


def _row(name: str, *cells: str) -> None:
    print(f"{name:>21}", *(f"{cell:>11}" for cell in cells), flush=True)


def _measure(ros: str, protocol: str, direction: str, names: Sequence[str]) -> None:
    with tempfile.TemporaryDirectory() as folder, _sides(ros, protocol, direction, names, folder) as (sender, receiver):
        there, here = receiver.ask("opened"), sender.ask("opened")
        linked = (here if direction == "transmit" else there)["linked"]
        opened = here["opened"] - linked if here["count"] == len(names) else float("nan")
        _row(
            f"{ros} {protocol} {direction}", f"{opened:.2f}", f"{here['errors'] + there['errors']:.0f}",
            f"{here['late']:.2f}", f"{there['late']:.2f}", f"{here['cpu'] + there['cpu']:.2f}",
        )  # fmt: skip


@contextlib.contextmanager
def _sides(
    ros: str, protocol: str, direction: str, names: Sequence[str], folder: str
) -> Iterator[tuple[bed.Process, bed.Process]]:
    """Return the side that sends, which knows all publishers, and the other side."""
    key = Path(folder) / "bench.key"
    key.write_bytes(base64.urlsafe_b64encode(os.urandom(32)))
    key.chmod(0o600)
    common: dict[str, Any] = {"names": names, "ros": ros, "protocol": protocol, "direction": direction}
    common |= {"folder": folder, "port": bed.free_port()}
    roles = ("client", "server") if direction == "transmit" else ("server", "client")
    with contextlib.ExitStack() as stack:
        sides = []
        if ros == "real":
            domain = bed.NEAR if direction == "transmit" else bed.FAR
            stack.enter_context(bed.Process("-m", "bench.opening", "publish", str(domain), *names)).line()
        for role in roles:
            options = json.dumps(common | {"role": role, "sends": role == roles[0]})
            sides.append(stack.enter_context(bed.Process("-m", "bench.opening", "side", options)))
            sides[-1].line()
        yield sides[0], sides[1]


def _side(
    names: Sequence[str],
    ros: str,
    protocol: Protocol,
    direction: Direction,
    folder: str,
    port: int,
    role: Role,
    sends: bool,
) -> None:
    topics = tuple(Topic(name, direction, protocol=protocol) for name in names)
    domain = bed.NEAR if role == "client" else bed.FAR
    session = Session(
        name="bench", role=role, server_ip="127.0.0.1", server_port=port, domain_id=domain, key_file="bench.key",
        topics=topics if role == "client" else (),
    )  # fmt: skip
    node = _stand_in(names) if ros == "stand-in" else RosNode(domain, "bench")
    engine = Engine(session, base=Path(folder), ros=node)
    engine.start()
    if sends:
        _discover(node, names)
    late = _lateness(engine)
    cpu = time.process_time()
    print("started", flush=True)
    sys.stdin.readline()
    print(json.dumps(_opened(engine, len(names)) | {"late": late[0], "cpu": time.process_time() - cpu}), flush=True)
    sys.stdin.readline()


def _opened(engine: Engine, topics: int) -> dict[str, float]:
    deadline = time.monotonic() + _OPEN_WITHIN
    while True:
        events = engine.events()
        opened = [event.time for event in events if event.code is EventCode.ROUTE_CONNECTED]
        if len(opened) >= topics or time.monotonic() > deadline:
            break
        time.sleep(0.05)
    linked = [event.time for event in events if event.code is EventCode.LINK_UP]
    since = [event for event in events if event.time >= min(linked, default=0.0)]
    return {
        "linked": min(linked, default=0.0),
        "opened": max(opened, default=0.0),
        "count": len(opened),
        "errors": sum(event.level in ("WARNING", "ERROR") for event in since),
    }


def _lateness(engine: Engine) -> list[float]:
    """Track the longest delay (s) of a timer of the engine's loop in the one entry of the returned list."""
    assert engine._bridge is not None
    loop, late = engine._bridge.context.loop, [0.0]

    def tick(due: float) -> None:
        late[0] = max(late[0], loop.time() - due)
        loop.call_at(loop.time() + _TICK, tick, loop.time() + _TICK)

    engine._bridge.context.call(lambda: tick(loop.time()))
    return late


class Services(NamedTuple):
    """200 services: s until all can be called, s that calls of all at once take; ms of one call after another."""

    seen: float
    answered: float
    p50: float
    p99: float


def _report_services() -> None:
    count = _NODES * _EACH
    print(f"\n{count} services of {_NODES} nodes; {_TURN} calls of each at once, then of a single one in turn")
    _row("", "seen, s", "answered, s", "p50, ms", "p99, ms")
    for kind in ("direct", "tcp"):
        _row(kind, *(f"{each:.2f}" for each in _measure_services(kind)))


def _measure_services(kind: str) -> Services:
    """Measure a client of 200 services that start while everything else runs."""
    names = [f"/many_{kind}_{node}_{number}" for node in range(_NODES) for number in range(_EACH)]
    with contextlib.ExitStack() as resources:
        server_domain = bed.NEAR if kind == "direct" else bed.FAR
        near, far = (resources.enter_context(contextlib.closing(CallNode(d))) for d in (bed.NEAR, server_domain))
        first = f"/first_{kind}"
        if kind == "tcp":
            resources.enter_context(calls.bridged(bed.NEAR, bed.FAR, [first, *names]))
        far.serve(first)
        near.waits_for(first)
        calls.check("the first call", first, near.call(first, quiet=calls.QUIET))
        near.ready(*names)  # its clients are there
        began = time.monotonic()
        for at, name in enumerate(names):
            far.serve(name, node=f"server{at // _EACH}")
        near.waits_for(*names)
        seen = time.monotonic() - began
        began = time.monotonic()
        for name in names:
            near.begin(name, _TURN, at_once=_TURN)
        for name in names:
            calls.check(f"{len(names)} services", name, near.settled(name, calls.QUIET))
        answered = time.monotonic() - began
        outcome = near.call(names[0], 300, quiet=calls.QUIET)
        calls.check("one of many", names[0], outcome)
        return Services(seen, answered, 1e3 * outcome.p50, 1e3 * outcome.p99)


def _stand_in(names: Sequence[str]) -> RosInterface:
    return StandIn(**{name[1:]: Qos() for name in names})


def _publish(domain: int, names: Sequence[str]) -> None:
    node = RosNode(domain, "bench_publishers")
    node.start()
    for name in names:
        node.advertise(TopicSpec(name, "std_msgs/msg/String", "", Qos()), "bench")
    print("published", flush=True)
    sys.stdin.readline()


def _floor(names: Sequence[str]) -> None:
    near, far = RosNode(bed.NEAR, "bench"), RosNode(bed.FAR, "bench")
    near.start()
    far.start()
    _discover(near, names)
    began = time.monotonic()
    for name in names:
        near.subscribe(TopicSpec(name, "std_msgs/msg/String", "", Qos()), lambda _: None, "bench")
    between = time.monotonic()
    for name in names:
        far.advertise(TopicSpec(name, "std_msgs/msg/String", "", Qos()), "bench")
    print(json.dumps({"subscriptions": between - began, "publishers": time.monotonic() - between}), flush=True)
    sys.stdin.readline()


def _discover(node: RosInterface, names: Sequence[str]) -> None:
    deadline = time.monotonic() + _DISCOVERED_WITHIN
    while not all(node.publishers(name) for name in names):
        if time.monotonic() > deadline:
            raise SystemExit("the publishers are not found")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
