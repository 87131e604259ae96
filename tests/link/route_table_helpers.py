"""Helpers of `test_route_table` and others."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from tests.support.offline import FakePeer

from rsb_bridge.config.rights import Rights
from rsb_bridge.link.base_link import LinkStatus
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposed_routes import ProposedTopics
from rsb_bridge.link.route_ids import RouteIds
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.model.demands import sources_of_entries
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from rsb_bridge.context import Context
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.demands import DemandSource
    from rsb_bridge.model.snapshot import Level
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose, UrgentMessage


TOPIC = Topic("/chat", "transmit")


class Side(FakePeer):
    """One side of a link: its table, and the messages in flight to it."""

    linked_at = 0.0
    connections = 1
    rights = Rights("the peer", "this side", "", allow=(), deny=())
    prefixed = use_name = False

    def __init__(self, context: Context, *, is_client: bool) -> None:
        super().__init__()
        self.is_client = is_client
        self.end = self
        self.context = context
        self.inbox: deque[Any] = deque()
        self.demands_counted = 0
        self.other: Side
        self.routes: dict[str, Route] = {}
        self.ids = RouteIds(is_client=is_client)
        self.status = LinkStatus(0.0, reason="cut")
        self.table = RouteTable(cast("BaseLink", self))
        self.proposed = ProposedTopics(cast("Link", self), self.table)
        self.handlers = {**self.table.messages, **self.proposed.messages}
        context.demands.register(self)

    # --- arming, as a link does it

    def demand_sources(self) -> Iterator[DemandSource]:
        self.demands_counted += 1
        topics = self.proposed.all()
        return sources_of_entries(topics, "robot1", on_server=not self.is_client, use_name=False)

    def apply_demands(self) -> None:
        self.table.apply_demands()

    def demand_dropped(self, source: DemandSource) -> None:
        self.table.arming.demand_dropped(source)

    # --- what an operator does, and what happens to a route

    def add(self, topic: Topic = TOPIC) -> None:
        with suppress(LinkError):  # it is there
            self.proposed.add(topic)

    def edit(self) -> None:
        for route in tuple(self.routes.values()):
            self.change(route, qos=7 if self.is_client else 9)

    def rename(self) -> None:
        for route in tuple(self.routes.values()):
            self.change(route, topic="/talk" if route.spec.topic == TOPIC.topic else TOPIC.topic, remote_topic=None)

    def change(self, route: Route, **keys: Any) -> None:
        topic = msgspec.structs.replace(route.spec, **keys)
        with suppress(LinkError):  # the new name is bridged
            entry = self.proposed.entry(topic)
            self.proposed.check_replace(route, entry)
            if route.proposed_here:
                self.proposed.replace(route, entry)
                return
            question = self.proposed.question(route, self.proposed.demand(route, topic))
            if question is not None and question.route:
                self.send(question)

    def remove(self) -> None:
        for route in tuple(self.routes.values()):
            self.table.remove(route, "by an operator")

    def pause(self, paused: bool) -> None:
        for route in self.routes.values():
            self.table.pause(route, paused=paused)

    def limit(self, rate: float | None) -> None:
        for route in self.routes.values():
            self.change(route, max_rate=rate)

    def lose(self) -> None:
        for route in self.routes.values():
            route.channel_lost(Reason("cut", EndCode.BROKE))

    def hear(self) -> None:
        if self.inbox:
            message = self.inbox.popleft()
            self.handlers[type(message)](message)

    @property
    def state(self) -> dict[str, tuple[object, ...]]:
        return {
            key: (
                route.pausing.paused,
                route.spec.max_rate,
                route.proposal.max_rate,
                route.proposal.qos,
                route.life.accepted,
            )
            for key, route in self.routes.items()
        }

    @property
    def apart(self) -> set[str]:
        """The topics that both sides list, with values that differ."""
        return {key for key, route in self.routes.items() if self.refusal_of(route).code is EndCode.LISTED_DIFFERENTLY}

    def refusal_of(self, route: Route) -> Reason:
        open_for = self.context.now() - route.opened_at if route.id else 0.0
        return route.reopening.shown_refusal(route.life, open_for)

    @property
    def listed(self) -> list[str]:
        """The names of the topics in its session."""
        return sorted(topic.topic for topic in self.proposed.all())

    # --- as the table's link

    def send(self, message: Any) -> None:
        self.other.inbox.append(message)

    def send_urgent(self, message: UrgentMessage) -> None:
        """Both ways bring it."""
        self.send(message)
        self.send(message)

    def closed(self, route_id: int) -> None:
        self.ids.closed(route_id)

    def derive_keys(self, route_id: int, *, proposed_here: bool) -> None:
        pass

    def refusal(self, topic: str) -> str:
        return ""

    def with_local_name(self, proposal: Propose) -> Propose:
        return proposal

    async def prepare_port(self, route: Route) -> None:
        return

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        before = asyncio._get_running_loop()
        asyncio._set_running_loop(self.context.loop)
        try:
            with pytest.raises(StopIteration):  # nothing in it waits
                work.send(None)
        finally:
            asyncio._set_running_loop(before)
        return None  # type: ignore[return-value]

    def guarded(self, work: Callable[[], None]) -> None:
        work()

    def protocol_error(self, reason: str) -> None:
        raise AssertionError(reason)

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "") -> None:
        pass


Pair = tuple["Side", "Side"]


def pair_of(client_context: Context, server_context: Context) -> Pair:
    client, server = Side(client_context, is_client=True), Side(server_context, is_client=False)
    client.other, server.other = server, client
    return client, server


def hear_all(pair: Pair) -> None:
    while any(side.inbox for side in pair):
        for side in pair:
            side.hear()
