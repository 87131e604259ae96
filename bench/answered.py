"""Count calls that their callers get no answer to: ``python -m bench.answered --bridge tcp --calls 10000``.

Stock rclpy nodes call one stock server, each in a process of its own, directly (``--bridge none``) or through a bridge
whose sides are processes too. Callers are replaced by new ones after some calls, as a call that follows on its caller's
start has its own ways to go wrong. It prints what the callers know, what the server has had, and both sides' ledgers.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from tests.support.locks import two_domains
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import load, save
from rsb_bridge.engine import Engine
from rsb_bridge.model.session import Session, Topic
from rsb_extras.zenoh import ZenohSettings

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
SERVICE = "/answered"
WAITS_FOR_SERVER = 60.0
"""s until a caller gives up."""
DEFAULT_DEPTH = 10
"""Requests or responses that rclpy's services hold, unless told otherwise."""


# --- processes: each prints a line when it is ready, and a line of JSON once its input ends or its work is done


def serve(domain_id: int, depth: int) -> None:
    """Answer all calls."""
    taken = 0

    def answer(_request: Any, response: Any) -> Any:
        nonlocal taken
        taken += 1
        response.success = True
        return response

    with _node(domain_id, "server") as (node, spin):
        node.create_service(Trigger, SERVICE, answer, qos_profile=QoSProfile(depth=depth))
        _say("ready")
        spin(_input_ended)
    _say({"taken": taken})


def call(domain_id: int, depth: int, calls: int, rate: float, burst: int, quiet: float) -> None:
    """Make calls at a rate, some at once, and wait until all are answered or none has been for a while."""
    with _node(domain_id, "caller") as (node, spin):
        client = node.create_client(Trigger, SERVICE, qos_profile=QoSProfile(depth=depth))
        assert client.wait_for_service(WAITS_FOR_SERVER), "no server"
        _say("ready")
        answers: dict[int, Any] = {}
        began = last = time.monotonic()
        asked_at: list[float] = []

        def work() -> bool:
            nonlocal last
            now = time.monotonic()
            if len(asked_at) < calls and now >= began + len(asked_at) / rate:
                for _ in range(min(burst, calls - len(asked_at))):
                    asked_at.append(now - began)
                    number, future = len(asked_at) - 1, client.call_async(Trigger.Request())
                    future.add_done_callback(lambda done, number=number: answers.__setitem__(number, done.result()))
                last = now
            if len(answers) != answered[0]:
                answered[0], last = len(answers), now
            return len(answers) == calls or (len(asked_at) == calls and now > last + quiet)

        answered = [0]
        spin(work)
    missing = [(number, round(asked_at[number], 3)) for number in range(calls) if number not in answers]
    _say({"asked": len(asked_at), "answered": len(answers), "missing": missing})


def bridge_half(folder: Path, role: str) -> None:
    """Run one side of the bridge, and count its calls in the end."""
    engine = Engine(load(folder / f"{role}.yaml"), base=folder)
    engine.start()
    try:
        eventually(lambda: any(route.calls is not None for route in engine.snapshot().routes), 180.0, "linked")
        _say("ready")
        eventually(_input_ended, float("inf"))
        time.sleep(1.5)  # a snapshot may be 1 s old
        (calls,) = (route.calls for route in engine.snapshot().routes if route.calls is not None)
        refused = sum(calls.refused.values())
        said = {key: getattr(calls, key) for key in ("asked", "answered", "expired", "lost", "late", "in_flight")}
    finally:
        engine.stop()
    _say({**said, "refused": refused})


@contextlib.contextmanager
def _node(domain_id: int, name: str) -> Iterator[tuple[Any, Any]]:
    """Join a domain with a stock node; gives it, and what spins it until a condition holds."""
    rclpy.init(domain_id=domain_id)
    node = rclpy.create_node(f"{name}_{os.getpid()}")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin(done: Any) -> None:
        while not done():
            # The wait is short, since a caller also has to see when its next call is due.
            executor.spin_once(timeout_sec=0.002)

    try:
        yield node, spin
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def _input_ended() -> bool:
    return bool(select.select([sys.stdin], [], [], 0)[0])


def _say(what: object) -> None:
    print(json.dumps(what), flush=True)


# --- the run


class Child:
    """One of those processes."""

    def __init__(self, what: str, **arguments: object) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.answered", "--child", what, json.dumps(arguments)],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def ready(self) -> None:
        """Wait for its line."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line == '"ready"\n', line

    def result(self, *, end: bool) -> dict[str, Any]:
        """Return its line of JSON; `end` ends it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        if end:
            self._process.stdin.close()
        line = self._process.stdout.readline()
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait(60)
        found: dict[str, Any] = json.loads(line)
        return found


def run(how: argparse.Namespace) -> None:
    """Make the calls, and print the counts."""
    domain_id = two_domains()
    there = domain_id if how.bridge == "none" else domain_id + 1
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as resources:
        server = Child("server", domain_id=there, depth=how.depth)
        server.ready()
        halves = [] if how.bridge == "none" else _halves(Path(name), how.bridge, domain_id, resources)
        asked = answered = 0
        began, rounds = time.monotonic(), 0
        while asked < how.calls:
            each = min(how.life, -(-(how.calls - asked) // how.callers))
            callers = [
                Child(
                    "caller", domain_id=domain_id, depth=how.depth, calls=each, rate=how.rate / how.callers / how.burst,
                    burst=how.burst, quiet=how.quiet,
                )
                for _ in range(how.callers)
            ]  # fmt: skip
            for caller in callers:
                caller.ready()
            rounds += 1
            for outcome in [caller.result(end=False) for caller in callers]:
                asked, answered = asked + outcome["asked"], answered + outcome["answered"]
                if how.verbose and outcome["missing"]:
                    print(f"  round {rounds}: without an answer (number, s): {outcome['missing']}", flush=True)
        took = time.monotonic() - began
        counts = {half: child.result(end=True) for half, child in halves}
        taken = server.result(end=True)["taken"]
    print(
        f"{how.bridge}: {asked} calls by {rounds} × {how.callers} callers in {took:.0f} s, depth {how.depth}, "
        f"{how.burst} at once: {answered} answered at the callers, {asked - answered} not; the server took {taken}"
    )
    for half, count in counts.items():
        print(f"  {half}: {count}")


def _halves(folder: Path, kind: str, domain_id: int, resources: contextlib.ExitStack) -> list[tuple[str, Child]]:
    """Start both sides of a bridge: callers are in the client's domain."""
    write_key(folder / "robot1.key")
    common: dict[str, Any] = {"name": "robot1", "key_file": "robot1.key"}
    if kind == "zenoh":
        from rsb_extras.zenoh.tests.zenoh_router import Router  # noqa: PLC0415 — the package is optional

        router = Router()
        resources.callback(router.close)
        common |= {
            "server_ip": "zenoh",
            "server_port": 0,
            "features": {"zenoh": ZenohSettings(connect=(router.endpoint,))},
        }
    else:
        common |= {"server_ip": "127.0.0.1", "server_port": free_port()}
    service = Topic(SERVICE, "transmit", kind="service")
    save(Session(role="server", domain_id=domain_id + 1, **common), folder / "server.yaml")
    save(Session(role="client", domain_id=domain_id, topics=(service,), **common), folder / "client.yaml")
    halves = [(role, Child("bridge", folder=str(folder), role=role)) for role in ("server", "client")]
    for _, half in halves:
        half.ready()
    return halves


def _child(what: str, arguments: dict[str, Any]) -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if what == "server":
        serve(**arguments)
    elif what == "caller":
        call(**arguments)
    else:
        bridge_half(Path(arguments["folder"]), arguments["role"])


def main() -> None:
    """Read the command line."""
    if sys.argv[1:2] == ["--child"]:
        _child(sys.argv[2], json.loads(sys.argv[3]))
        return
    parser = argparse.ArgumentParser(prog="python -m bench.answered")
    parser.add_argument("--bridge", choices=("none", "tcp", "zenoh"), default="tcp", help="what is between them")
    parser.add_argument("--calls", type=int, default=10_000, help="in all")
    parser.add_argument("--callers", type=int, default=3, help="at a time")
    parser.add_argument("--life", type=int, default=500, help="calls of a caller, until a new one takes its place")
    parser.add_argument("--rate", type=float, default=100.0, help="calls a second, of all callers")
    parser.add_argument("--burst", type=int, default=1, help="calls that a caller makes at once")
    parser.add_argument("--depth", type=int, default=DEFAULT_DEPTH, help="of the callers' and the server's QoS")
    parser.add_argument("--quiet", type=float, default=15.0, help="s without an answer until the rest is given up")
    parser.add_argument("--verbose", action="store_true", help="list the calls without an answer")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
