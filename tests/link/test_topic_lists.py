"""The lists of their graphs that the two sides of a link exchange."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support.slices import take

from rsb_bridge.link.questions import TopicLists
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_graph import MOST_ENTRIES
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.wire.codec import decode, encode, pack_topics, topic_entries
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import ListTopics, TopicList
from rsb_bridge.wire.records import TopicEntry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.model.session import Kind
    from rsb_bridge.model.snapshot import TopicInfo
    from rsb_bridge.wire.messages import ControlMessageBase

FIBONACCI = {
    "/fibonacci/_action/send_goal": "test_msgs/action/Fibonacci_SendGoal",
    "/fibonacci/_action/cancel_goal": "action_msgs/srv/CancelGoal",
    "/fibonacci/_action/get_result": "test_msgs/action/Fibonacci_GetResult",
}


class Graph(NoRos):
    """A graph with a publisher on each topic and a server of each service."""

    def __init__(self, topics: Mapping[str, str], services: Mapping[str, str]) -> None:
        self._topics, self._services = topics, services

    def topics(self) -> dict[str, list[str]]:
        return {name: [type_name] for name, type_name in self._topics.items()}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/node", self._topics[topic], "RIHS01_1", Qos())]

    def services(self) -> dict[str, list[str]]:
        return {name: [type_name] for name, type_name in self._services.items()}

    def servers(self, service: str) -> list[Endpoint]:
        return [Endpoint("/node", self._services[service], "RIHS01_2", Qos())]


class Pair:
    """One side that asks and one that answers; messages between them are encoded.

    Attributes:
        said: the sizes (bytes) of the answers.
    """

    def __init__(
        self,
        graph: NoRos,
        shows: Callable[[str, Kind], bool] = lambda *_: True,
        through: Callable[[ControlMessageBase], ControlMessageBase] = lambda message: message,
    ) -> None:
        self.said: list[int] = []
        self._through = through
        self._tasks: list[asyncio.Task[None]] = []

        def lists(other: Callable[[], TopicLists]) -> TopicLists:
            link: Any = SimpleNamespace(
                context=SimpleNamespace(ros=graph, now=time.monotonic),
                end=SimpleNamespace(shows=shows),
                send=lambda message: take(other(), self._crossed(message)),
                spawn=self._spawn,
            )
            return TopicLists(link)

        self.asking, self.answering = lists(lambda: self.answering), lists(lambda: self.asking)

    def _spawn(self, work: Any) -> None:
        self._tasks.append(asyncio.ensure_future(work))

    def _crossed(self, message: ControlMessageBase) -> Any:
        data = encode(self._through(message))
        if isinstance(message, TopicList):
            self.said.append(len(data))
        return decode(data)

    def ask(self) -> list[TopicInfo]:
        async def main() -> list[TopicInfo]:
            return await self.asking.ask()

        return asyncio.run(main())


def found(infos: list[TopicInfo]) -> list[tuple[str, str]]:
    return [(info.kind, info.topic) for info in infos]


def test_all_that_can_be_bridged_is_told() -> None:
    graph = Graph(
        {"/scan": "a/msg/B", "/fibonacci/_action/feedback": "a/msg/C", "/fibonacci/_action/status": "a/msg/D"},
        {"/add": "example/srv/Add", **FIBONACCI, "/node/list_parameters": "rcl_interfaces/srv/ListParameters"},
    )
    infos = Pair(graph).ask()
    assert found(infos) == [
        ("topic", "/scan"), ("action", "/fibonacci"), ("parameters", "/node"), ("service", "/add"),
    ]  # fmt: skip
    assert [(info.type_name, info.type_hash, info.publishers) for info in infos] == [
        ("a/msg/B", "RIHS01_1", 1),
        ("test_msgs/action/Fibonacci", "", 1),
        ("", "", 1),
        ("example/srv/Add", "RIHS01_2", 1),
    ]


def test_what_is_denied_is_not_shown() -> None:
    graph = Graph({"/scan": "a/msg/B"}, {"/scan": "example/srv/Add", **FIBONACCI})
    pair = Pair(graph, shows=lambda name, kind: (name, kind) in [("/scan", "service"), ("/fibonacci", "topic")])
    assert found(pair.ask()) == [("service", "/scan")]


def test_kinds_that_only_a_newer_side_knows() -> None:
    def newer(message: ControlMessageBase) -> ControlMessageBase:
        if isinstance(message, ListTopics):
            return message
        assert isinstance(message, TopicList)
        entries = [entry for entry, _ in topic_entries(message.topics)]
        thought = TopicEntry("/thought", "", "", None, 1, 0, "telepathy")
        return msgspec.structs.replace(message, topics=pack_topics([thought, *entries]))

    assert found(Pair(Graph({"/scan": "a/msg/B"}, {}), through=newer).ask()) == [("topic", "/scan")]


@pytest.mark.parametrize("length", [20, 240])
def test_list_fits_one_message_with_all_kinds(length: int) -> None:
    topics = {f"/topic_{number:05}".ljust(length, "x"): "a/msg/" + "B" * length for number in range(3 * MOST_ENTRIES)}
    services = {f"/service_{number:05}": "example/srv/Add" for number in range(MOST_ENTRIES)}
    pair = Pair(Graph(topics, {**services, **FIBONACCI}))
    kinds = [info.kind for info in pair.ask()]
    assert pair.said[0] < CONTROL_LIMIT
    assert pair.said[0] < 30 * len(kinds), "they are compressed"
    assert kinds.count("action") == 1
    assert min(kinds.count("topic"), kinds.count("service")) >= 499
