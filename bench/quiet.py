"""Prints what quiet routes cost: ``python -m bench.quiet [rounds [topics]]``, three minutes and one more a round.

Each topic of two linked sides had one message two minutes ago, and none since. CPU in % of a core of either side, by
thread, while nobody looks and while somebody looks four times a second, as a console does. Under ``stand-in`` there is
no ROS behind the engines: what the bridge itself takes. Under ``real``, publishers are in a process of their own.

``python -m bench.quiet table`` prints what a message costs beside quiet topics (`bench.beside_quiet`).
"""

from __future__ import annotations

import contextlib
import json
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from bench import bed, beside_quiet
from bench.quiet_side import wait_until_open

from rsb_bridge.cdr.known_types import STRING, STRING_HASH, stamped_string
from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.demo.stand_in import StandIn, Talk

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Role
    from rsb_bridge.ros.ros_interface import RosInterface

ROUNDS, TOPICS, FEW = 3, 500, 4
LOOKS = 4.0
"""Hz at which a console asks for the snapshot."""
_SETTLES, _SECONDS = 140.0, 10.0
"""s until routes rest (`rsb_bridge.route.idling.Idling`), and s of a measurement."""
_OPEN_WITHIN = 120.0
_SIZE = 100
_Figures: TypeAlias = "dict[str, list[list[dict[str, float]]]]"
"""By bed, round and side: CPU in % of a core by thread."""
_OTHERS = "ROS and others"
"""Threads that Python did not start."""


def main() -> None:
    match sys.argv[1:]:
        case ["side", options]:
            _side(**json.loads(options))
        case ["announce", domain, *names]:
            _publish(int(domain), names)
        case ["table", *options]:
            beside_quiet.main(options)
        case ["publish" | "subscribe" | "talk" as part, domain, *names]:
            beside_quiet.ends(part, int(domain), names)
        case [] | [_] | [_, _]:
            rounds, topics, *_ = [*map(int, sys.argv[1:]), *(ROUNDS, TOPICS)[len(sys.argv) - 1 :]]
            report(rounds, topics)


def report(rounds: int, topics: int) -> None:
    """Measure and print."""
    beds = {f"{count} topics, {ros}": (ros, count) for ros, count in _beds(topics)}
    with contextlib.ExitStack() as stack:
        sides = {
            name: stack.enter_context(_sides(ros, [f"/bench/topic_{number}" for number in range(count)]))
            for name, (ros, count) in beds.items()
        }
        time.sleep(_SETTLES)
        quiet: _Figures = {name: [] for name in beds}
        looked: _Figures = {name: [] for name in beds}
        for _ in range(rounds):
            for name in beds:
                for looks, taken in ((0.0, quiet), (LOOKS, looked)):
                    taken[name].append(_measure(sides[name], looks))
    print(f"CPU in % of a core, medians of {rounds} rounds of {_SECONDS:g} s, of the sending and of the receiving side")
    for name in beds:
        _row(name, quiet[name])
        _row("  while somebody looks", looked[name])


def _beds(topics: int) -> list[tuple[str, int]]:
    return [("stand-in", FEW), ("stand-in", topics), ("real", topics)]


def _measure(sides: tuple[bed.Process, bed.Process], looks: float) -> list[dict[str, float]]:
    for side in sides:
        side.ask(f"begin {looks}")
    time.sleep(_SECONDS)
    return [side.ask("end") for side in sides]


def _row(name: str, rounds: Sequence[Sequence[dict[str, float]]]) -> None:
    cells = []
    for taken in zip(*rounds, strict=True):
        threads = {thread for each in taken for thread in each}
        by_thread = {each: statistics.median(one.get(each, 0.0) for one in taken) for each in threads}
        parts = ", ".join(f"{each} {used:.2f}" for each, used in sorted(by_thread.items()) if used >= 0.01)
        cells.append(f"{statistics.median(sum(one.values()) for one in taken):6.2f} ({parts})")
    print(f"{name:<24}", *(f"{cell:<56}" for cell in cells), flush=True)


@contextlib.contextmanager
def _sides(ros: str, names: Sequence[str]) -> Iterator[tuple[bed.Process, bed.Process]]:
    """Yield the sending and the receiving side, once each topic has had its message."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        write_key(Path(folder) / "bench.key")
        common = {"ros": ros, "names": names, "folder": folder, "port": bed.free_port()}
        publishing = None
        if ros == "real":
            publishing = stack.enter_context(bed.Process("-m", "bench.quiet", "announce", str(bed.NEAR), *names))
            publishing.line()
        server, client = (
            stack.enter_context(bed.Process("-m", "bench.quiet", "side", json.dumps(common | {"role": role})))
            for role in ("server", "client")
        )
        client.ask("open")
        (publishing or client).ask("publish")
        yield client, server


def _side(ros: str, names: Sequence[str], folder: str, port: int, role: Role) -> None:
    sends = role == "client"
    domain = bed.NEAR if sends else bed.FAR
    session = Session(
        name="bench", role=role, server_ip="127.0.0.1", server_port=port, domain_id=domain, key_file="bench.key",
        topics=tuple(Topic(name, "transmit") for name in names) if sends else (),
    )  # fmt: skip
    stand_in = StandIn(role, [Talk(name, 1.0, _SIZE) for name in names] if sends else (), () if sends else names)
    node: RosInterface = stand_in if ros == "stand-in" else RosNode(domain, role)
    engine = Engine(session, base=Path(folder), ros=node)
    engine.start()
    ended = threading.Event()
    before, began = _threads(), time.monotonic()
    for line in sys.stdin:
        answer: dict[str, float] = {}
        match line.split():
            case ["open"]:
                wait_until_open(engine, len(names), _OPEN_WITHIN)
            case ["publish"]:
                for name in names:
                    stand_in.publish(name, _SIZE)
            case ["begin", looks]:
                ended.clear()
                threading.Thread(target=_look, args=(engine, float(looks), ended), name="looks").start()
                before, began = _threads(), time.monotonic()
            case ["end"]:
                seconds = time.monotonic() - began
                for (number, name), used in _threads().items():
                    answer[name] = answer.get(name, 0.0) + (used - before.get((number, name), 0.0)) / seconds * 100
                ended.set()
        print(json.dumps(answer), flush=True)


def _look(engine: Engine, rate: float, ended: threading.Event) -> None:
    while rate and not ended.wait(1 / rate):
        engine.snapshot()


def _threads() -> dict[tuple[int, str], float]:
    """Return the CPU time (s) of each thread by its number and name, as the kernel counts it (schedstat)."""
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    found = {}
    for thread in Path("/proc/self/task").iterdir():
        number = int(thread.name)
        with contextlib.suppress(OSError):  # it has ended
            found[number, names.get(number, _OTHERS)] = int((thread / "schedstat").read_text().split()[0]) / 1e9
    return found


def _publish(domain: int, names: Sequence[str]) -> None:
    node = RosNode(domain, "bench_publishers")
    node.start()
    publishers = [node.advertise(TopicSpec(name, STRING, STRING_HASH, Qos()), "bench") for name in names]
    print("there", flush=True)
    sys.stdin.readline()
    for publisher in publishers:
        publisher.publish(stamped_string(_SIZE))
    print("{}", flush=True)
    sys.stdin.readline()


if __name__ == "__main__":
    main()
