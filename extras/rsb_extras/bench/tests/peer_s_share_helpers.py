"""Helpers of `test_peer_s_share` and others."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.internal_ends import InternalEnds
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.benchmark import BENCH
from rsb_extras.bench.link_bench import BenchAnswer, BenchAsk, LinkBench

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.route_table import RouteTable


PEER = "robot1"


class Here:
    """This side of a link to a peer that may send 100 messages a second, for 10 s and 1 MB."""

    def __init__(self) -> None:
        self.time = 0.0
        self.ends = InternalEnds[Any, Any](BENCH)
        self.denied: list[str] = []
        self.answers: list[BenchAnswer] = []
        loop = SimpleNamespace(call_soon=lambda work: work())
        self.routes: dict[str, Any] = {}
        ids = SimpleNamespace(open_route=lambda number: list(self.routes.values())[number])
        table = SimpleNamespace(deny=lambda _, reason: self.denied.append(reason))
        context = SimpleNamespace(internal={BENCH.name: self.ends}, clock=Clock(), now=lambda: self.time, loop=loop)
        rights = SimpleNamespace(features={LIMITS.name: BenchmarkLimits(seconds=10.0, max_rate=100.0, megabytes=1.0)})
        link = SimpleNamespace(
            context=context,
            routes=self.routes,
            ids=ids,
            linked=True,
            carriers=set,
            name=PEER,
            send=self.answers.append,
            spawn=asyncio.run,
            end=SimpleNamespace(rights=rights),
        )
        self.bench = LinkBench(cast("BaseLink", link), cast("RouteTable", table))

    def open(self, topic: str) -> Any:
        """The peer opens a route, which takes the place of another of its name."""
        route = SimpleNamespace(key=topic, local_topic=topic, purpose=BENCH, proposed_here=False, id=1, refusal="")
        self.routes[topic] = route
        return self.ends.advertise(TopicSpec(topic, "", "", Qos()), PEER)

    @property
    def own(self) -> set[Any]:
        """The messages that the peer was asked for."""
        return self.bench._own

    def ask(self, **wanted: Any) -> BenchAnswer:
        self.bench.messages[BenchAsk](BenchAsk(1, 0, **wanted))
        return self.answers.pop()

    def second(self) -> None:
        self.time += 1.0
        self.bench.tick()
