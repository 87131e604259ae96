"""Counts what a subscriber hears of latched topics whose link is cut: ``python -m tests.route.latched_cuts``.

Nine topics, of 2, 10 and 25 Hz and depths of 1, 10 and 100, cross to a subscriber that is there all the time. A line
counts the messages that the sender's ledger calls delivered, the messages that the subscriber heard, and its messages
that came after a newer one; it ends with the longest time without a message. On a busy machine many were lost:
``--niceness 10 --hogs 6``.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import operator
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from tests.support.asked import Asked, answers
from tests.support.forker import Forked
from tests.support.locks import domains_of
from tests.support.ports import free_port
from tests.support.program import Programs
from tests.support.relay import same_port
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key
from rsb_bridge.control.remote_engine import attach
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.snapshot import RouteSnapshot, State

RATES, DEPTHS = (2, 10, 25), (1, 10, 100)
_CUT = 3.0, 4.5
_FLOWS = 5.0, 8.0
_LISTENS_WITH = 500
"""Depth of the subscriber."""
_ARRIVES_WITHIN = 30.0
"""s that a delivered message may take to the subscriber, on the busiest machine."""


class LatchedTopic(NamedTuple):
    rate: int
    depth: int

    @property
    def name(self) -> str:
        return f"/latched_{self.rate}_hz_{self.depth}"


TOPICS = [LatchedTopic(*each) for each in itertools.product(RATES, DEPTHS)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", type=int, default=14)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hogs", type=int, default=0, help="processes that only compute")
    parser.add_argument("--niceness", type=int, default=0, help="of the whole run, against other programs")
    parser.add_argument("--protocol", default="tcp")
    parser.add_argument("--keep", type=Path, help="folder for logs and all that was heard")
    options = parser.parse_args()
    os.nice(options.niceness)
    with contextlib.ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rsb-latched-")))
        folder.mkdir(exist_ok=True)
        for _ in range(options.hogs):
            hog = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(hog.wait)
            stack.callback(hog.kill)
        loads: list[float] = []
        published, delivered, heard, said = _run(folder, options, stack, loads)
    lines = [f"load {min(loads):.0f} to {max(loads):.0f}", *said]
    lines.append("Hz | depth | published | delivered | heard | of these too old | longest pause s | state")
    count = {"delivered": 0, "heard": 0}
    for topic in TOPICS:
        route, told = delivered[topic.name], heard[topic.name]
        count["delivered"] += route.ledger.delivered
        count["heard"] += told["heard"]
        lines.append(
            f"{topic.rate} | {topic.depth} | {published[topic.name]} | {route.ledger.delivered} | {told['heard']} | "
            f"{told['old']} | {told['pause']:.1f} | {route.state.name}"
        )
    print(*lines, f"all: {count['delivered']} delivered, {count['heard']} heard", sep="\n")  # noqa: T201


def _run(folder: Path, options: argparse.Namespace, stack: contextlib.ExitStack, loads: list[float]) -> Any:
    first = domains_of("programs")
    random, port = Random(options.seed), free_port()
    relay = stack.enter_context(same_port(port))
    write_key(folder / "key.txt")
    common: dict[str, Any] = {"name": "robot1", "server_port": port, "key_file": "key.txt"}
    programs = Programs(folder)
    stack.callback(programs.close)
    environ = {"XDG_STATE_HOME": str(folder)}
    server = programs.start(
        Session(role="server", server_ip=relay.target[0], domain_id=first + 1, **common), environ=environ
    )
    topics = tuple(Topic(each.name, "transmit", protocol=options.protocol) for each in TOPICS)
    programs.start(
        Session(role="client", server_ip=relay.host, domain_id=first, topics=topics, **common), environ=environ
    )
    listener, talker = (_end(stack, "listen", first + 1), _end(stack, "talk", first))
    eventually((folder / "client1.yaml.sock").exists)
    engine = stack.enter_context(attach(folder / "client1.yaml.sock", read_only=True))
    eventually(lambda: talker.ask()["matched"] and listener.ask()["matched"], what="all topics known")
    talker.ask(talks=True)
    for _ in range(options.cuts):
        time.sleep(random.uniform(*_FLOWS))
        relay.refuse()
        time.sleep(random.uniform(*_CUT))
        relay.refuse(False)
        loads.append(os.getloadavg()[0])
    time.sleep(_FLOWS[1])
    published = talker.ask(talks=False)["published"]

    def settled() -> dict[str, RouteSnapshot] | None:
        routes = {each.topic: each for each in engine.snapshot().routes}
        done = len(routes) == len(TOPICS) and not any(each.ledger.open for each in routes.values())
        return routes if done and not any(each.state is State.WAITING for each in routes.values()) else None

    time.sleep(2.0)
    routes = eventually(settled, what="nothing in flight")
    deadline = time.monotonic() + _ARRIVES_WITHIN
    heard = listener.ask()["topics"]
    while time.monotonic() < deadline and any(heard[name]["heard"] < routes[name].ledger.delivered for name in heard):
        time.sleep(0.5)
        heard = listener.ask()["topics"]
    said = [text for text in server.said if "publisher is closed" in text]
    (folder / "heard.json").write_text(json.dumps(listener.ask(numbers=True)))
    return published, routes, heard, said


def _end(stack: contextlib.ExitStack, *arguments: object) -> Asked:
    words = map(str, arguments)
    made = Asked(Forked("tests.route.latched_cuts", *words, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
    stack.callback(made.close)
    return made


def _qos(depth: int) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile

    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _talk(domain_id: int) -> None:
    from tests.support.domain import Domain, text

    domain = Domain(domain_id)
    ends = {each: domain.publisher(each.name, qos=_qos(each.depth)) for each in TOPICS}
    counts = dict.fromkeys(TOPICS, 0)
    due = dict.fromkeys(TOPICS, 0.0)
    talks = False

    def act(request: dict[str, Any]) -> object:
        nonlocal talks
        if "talks" in request:
            talks = request["talks"]
            due.update(dict.fromkeys(TOPICS, time.monotonic()))
        matched = all(end.get_subscription_count() for end in ends.values())
        return {"published": {each.name: count for each, count in counts.items()}, "matched": matched}

    while answers(act, 0.005):
        for topic, at in due.items() if talks else ():
            if time.monotonic() >= at:
                counts[topic] += 1
                ends[topic].publish(text(f"{counts[topic]}"))
                due[topic] = max(at, time.monotonic() - 1.0) + 1 / topic.rate


def _listen(domain_id: int) -> None:
    from tests.support.domain import Domain

    domain = Domain(domain_id)
    ends = {each.name: domain.listener(each.name, qos=_qos(_LISTENS_WITH)) for each in TOPICS}
    numbers: dict[str, list[int]] = {name: [] for name in ends}
    times: dict[str, list[float]] = {name: [] for name in ends}

    def act(request: dict[str, Any]) -> object:
        if request:
            return {"numbers": numbers, "times": times}
        return {
            "matched": all(end.matched for end in ends.values()),
            "topics": {
                name: {
                    "heard": len(set(heard)),
                    "old": sum(map(operator.lt, heard, itertools.accumulate(heard, max))),
                    "pause": max((b - a for a, b in itertools.pairwise(times[name])), default=0.0),
                }
                for name, heard in numbers.items()
            },
        }

    while answers(act, 0.01):
        for name, end in ends.items():
            if count := len(end.payloads):
                numbers[name] += map(int, end.texts(count))
                times[name] += [time.monotonic()] * count
                end.forget()


if __name__ == "__main__":
    if sys.argv[1:2] in (["talk"], ["listen"]):
        {"talk": _talk, "listen": _listen}[sys.argv[1]](int(sys.argv[2]))
    else:
        main()
