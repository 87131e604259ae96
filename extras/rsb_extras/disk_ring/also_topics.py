"""Topics of this side's domain that are recorded also while no link carries them."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from msgspec.structs import replace

from rsb_bridge.feature_api import RosError, Sender, TopicSpec
from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.model.patterns import Pattern, is_hidden, is_pattern
from rsb_bridge.model.qos import AUTO_DEPTH, match_publishers
from rsb_bridge.ros.ros_graph import agreed_type

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.feature_api import Bridge, Context, RawMessage, Tap
    from rsb_extras.recording.passing_messages import PassingMessages

MOST = 250
"""Topics. A round figure, as of patterns on a link."""
_LOOKS_EVERY = 5.0  # s between two looks at the graph. A round figure
_ORIGIN = "disk ring"  # differs from the names of links, which have no space


class _Also:
    """A topic that is subscribed to; its tap gets the messages on the I/O thread."""

    def __init__(self, spec: TopicSpec, tap: Tap, context: Context) -> None:
        self.spec = spec
        self._tap = tap
        self._wall_ns = context.wall_ns
        put = partial(context.ros_queue.put, self)
        self.subscription = context.ros.subscribe(spec, put, _ORIGIN)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        now = self._wall_ns()
        for each in batch:
            self._tap(each.payload, now, each.source or now, each.gid, each.number)


class AlsoTopics:
    """Subscribes to what matches names and patterns, and to what no route takes already."""

    def __init__(self, bridge: Bridge, passing: PassingMessages) -> None:
        self._bridge = bridge
        self._context = bridge.context
        self._passing = passing
        self._patterns: list[Pattern] = []
        self._topics: dict[str, _Also] = {}
        self._looked_at = float("-inf")
        self._carried: set[str] = set()
        self._looking: asyncio.Task[None] | None = None

    def follow(self, names: Iterable[str]) -> None:
        """Record what matches names and patterns from now on, and nothing else."""
        self._patterns = [Pattern(each) for each in names]
        for topic in [*self._topics]:
            self._drop(topic)
        if self._looking is not None:
            self._looking.cancel()
            self._looking = None
        self._looked_at = float("-inf")

    def look(self) -> None:
        """Look for topics that have come or gone, now and then, or that links have left. Called once a second."""
        if not self._patterns:
            return
        before, self._carried = self._carried, self._carried_now()
        for topic in self._carried & self._topics.keys():  # at once: else each message would be in the ring twice
            self._drop(topic)
        if before - self._carried:  # each second counts: their messages are in no ring
            self._looked_at = float("-inf")
        now = self._context.now()
        is_looking = self._looking is not None and not self._looking.done()
        if not is_looking and now - self._looked_at >= _LOOKS_EVERY:
            self._looked_at = now
            self._looking = self._context.loop.create_task(self._look())

    async def _look(self) -> None:
        with suppress(RosError):  # the graph cannot be read: the bridge says so itself
            found = await asyncio.to_thread(self._matching, self._carried)
            for topic in self._topics.keys() - found.keys():
                self._drop(topic)
            for topic, spec in found.items():
                if topic not in self._topics or self._topics[topic].spec != spec:
                    self._drop(topic)
                    with suppress(RosError):  # of a bad type: the look after asks again
                        self._take(spec)

    def _carried_now(self) -> set[str]:
        """Return the topics that a route takes from ROS now: without a link, it is there and takes none."""
        routes = (route for link in self._bridge.role.links() for route in link.routes.values())
        return {
            route.local_topic for route in routes if isinstance(route.half, Sender) and route.half.subscription.receives
        }

    def _matching(self, carried: set[str]) -> dict[str, TopicSpec]:
        """Return what is published and matches, as one subscription to it asks for it. Takes a while."""
        ros, found = self._context.ros, dict[str, TopicSpec]()
        for topic in sorted(ros.topics().keys() - carried):
            if len(found) >= MOST:
                break
            if not self._is_wanted(topic):
                continue
            publishers = ros.publishers(topic)
            type_name, type_hash = agreed_type(publishers)
            is_foreign = any(each.has_foreign_key for each in publishers)
            if type_name and not (is_foreign and not ros.survives_foreign_keys(type_name)):
                qos = match_publishers([each.qos for each in publishers])
                depth = LATCHED_DEPTH if qos.latched else AUTO_DEPTH
                qos = replace(qos, depth=depth, deadline=0.0, liveliness_lease_duration=0.0)
                found[topic] = TopicSpec(topic, type_name, type_hash, qos)
        return found

    def _is_wanted(self, topic: str) -> bool:
        return any(
            each.match(topic) is not None and not (is_pattern(each.text) and is_hidden(topic))
            for each in self._patterns
        )

    def _take(self, spec: TopicSpec) -> None:
        self._topics[spec.topic] = _Also(spec, self._passing.tap(spec.topic, spec), self._context)

    def _drop(self, topic: str) -> None:
        if (also := self._topics.pop(topic, None)) is not None:
            also.subscription.close()
