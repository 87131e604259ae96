"""One side of ours for `bench.quiet table`: ``python -m bench.quiet_side ROLE FOLDER PORT DOMAIN TOPIC...``.

It says that it has started, and answers lines: ``open`` once all topics are open, ``turn`` with the most CPU time (ms)
that the loop's thread has used between two waits since it was asked last. A topic with ``:express`` behind its name
leaves at once, where the checkout knows that.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from bench.named_threads import name_threads

from rsb_bridge.engine import Engine, freeze_heap, io_loop
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.ros.node import RosNode

if TYPE_CHECKING:
    from rsb_bridge.model.session import Role

_OPEN_WITHIN = 180.0


EXPRESS = ":express"
"""Behind the name of such a topic."""


def wait_until_open(engine: Engine, count: int, within: float) -> None:
    """Wait until so many topics are open, and end the process if they are not within so many s."""
    deadline = time.monotonic() + within
    while sum(event.code is EventCode.ROUTE_CONNECTED for event in engine.events()) < count:
        if time.monotonic() > deadline:
            raise SystemExit("the topics do not open")
        time.sleep(0.1)


class Turns:
    """Notes the longest turn of the loop, except for what a socket's reader does during the wait."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._began = 0.0
        self._select: Any = io_loop._Selector.select
        io_loop._Selector.select = self._noted()  # type: ignore[method-assign]

    def _noted(self) -> Any:
        def select(selector: Any, timeout: float | None = None) -> Any:
            if self._began:
                self.longest = max(self.longest, time.thread_time() - self._began)
            found = self._select(selector, timeout)
            self._began = time.thread_time()
            return found

        return select


def _topic(name: str) -> Topic:
    is_express = name.endswith(EXPRESS) and "express" in Topic.__struct_fields__
    express: dict[str, Any] = {"express": True} if is_express else {}
    return Topic(name.removesuffix(EXPRESS), "transmit", type="std_msgs/msg/String", **express)


def main() -> None:
    role, folder, port, domain, *names = sys.argv[1:]
    name_threads()
    turns = Turns()
    session = Session(
        name="bench", role=cast("Role", role), server_ip="127.0.0.1", server_port=int(port), domain_id=int(domain),
        key_file="bench.key", topics=tuple(map(_topic, names)),
    )  # fmt: skip
    engine = Engine(session, base=Path(folder), ros=RosNode(int(domain), role))
    engine.start()
    freeze_heap()  # as a bridge without a console does
    print("{}", flush=True)
    for line in sys.stdin:
        answer: dict[str, float] = {}
        if line.strip() == "open":
            wait_until_open(engine, len(names), _OPEN_WITHIN)
        else:
            answer["longest"], turns.longest = turns.longest * 1000, 0.0
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
