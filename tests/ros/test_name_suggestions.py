"""Suggestions for a name that nobody serves, or that nobody publishes, at a bounded cost."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from tests.support.virtual_time import virtual_loop

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_graph import (
    Asked,
    Meant,
    MeantNames,
    NameSuggester,
    Searches,
    SimilarTopics,
    Sought,
    is_mistyped,
)
from rsb_bridge.ros.ros_interface import Endpoint, RosError

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind


async def answered(searches: Searches[Asked], asked: Asked) -> str:
    """Ask, and give the search the time it takes."""
    changes = list[bool]()
    before = searches.of(asked, lambda: changes.append(True))
    for _ in range(100):
        await asyncio.sleep(0)
    answer = searches.of(asked, lambda: None)
    assert changes == [True] * (answer != before)
    return answer


def found(searches: type[Searches[Asked]], graph: NoRos, asked: Asked) -> str:
    async def ask() -> str:
        return await answered(searches(graph, asyncio.get_running_loop()), asked)

    return asyncio.run(ask())


class _Graph(NoRos):
    """One with an action /navigate, a node /dock_server with parameters, and a service /dock.

    Attributes:
        asked: how often for all services.
    """

    def __init__(self) -> None:
        self._served = {"/dock"}
        wholes: tuple[tuple[Kind, str], ...] = (("action", "/navigate"), ("parameters", "/dock_server"))
        for kind, name in wholes:
            self._served |= {name + lane.suffix for lane in LANES[kind] if not lane.is_topic}
        self.asked = 0

    def services(self) -> dict[str, list[str]]:
        self.asked += 1
        return {service: [] for service in (*self._served, "/dokc_called_only", "/_hidden")}

    def servers(self, service: str) -> list[Endpoint]:
        return [Endpoint("/node", "", "", Qos())] if service in self._served else []


class _Typed(NoRos):
    """One with types: an action /docks/go, a node /docks/server with parameters, and a service /docks/stop."""

    def services(self) -> dict[str, list[str]]:
        action, parameters = LANES["action"][0], LANES["parameters"][0]
        return {
            f"/docks/go{action.suffix}": [f"dock_msgs/action/Go{action.type_suffix}"],
            f"/docks/server{parameters.suffix}": [parameters.type_name],
            "/docks/called_only": ["std_srvs/srv/Empty"],
            "/docks/stop": ["std_srvs/srv/Empty"],
        }

    def servers(self, service: str) -> list[Endpoint]:
        return [Endpoint("/node", "", "", Qos())] if service != "/docks/called_only" else []


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("service", "/dokc", "/dock?"),
        ("service", "/navigate", "under actions"),
        ("service", "/dock_server", "under parameters"),
        ("service", "/dokc_called_onyl", ""),
        ("service", "/scan", ""),
        ("action", "/navigat", "/navigate?"),
        ("action", "/dock", "under services"),
        ("parameters", "/dock_srver", "/dock_server?"),
        ("parameters", "/navigate", "under actions"),
    ],
)
def test_other_kinds_and_similar_names_are_suggested(kind: Kind, name: str, words: str) -> None:
    hint = found(NameSuggester, _Graph(), (kind, name))
    assert bool(hint) is bool(words)
    assert words in hint


def test_it_is_not_searched_for_at_each_question() -> None:
    graph = _Graph()

    async def ask() -> list[str]:
        meant = NameSuggester(graph, asyncio.get_running_loop())
        await answered(meant, ("service", "/dokc"))
        return [meant.of(("service", name), lambda: None) for name in ("/dokc", "/dokc", "/navigate")]

    assert asyncio.run(ask()) == ["did you mean /dock?"] * 2 + [""]
    assert graph.asked == 1


class _Topics(NoRos):
    def __init__(self, *published: str) -> None:
        self.published = published
        self.asked = 0

    def topics(self) -> dict[str, list[str]]:
        self.asked += 1
        return {topic: [] for topic in (*self.published, "/w_typ", "/rosout")}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/talker", "", "", Qos())] if topic in self.published else []


def test_only_what_is_published_and_alike_is_named() -> None:
    graph = _Topics("/w_typo", "/robot1/camera/image_raw", "/odom")
    for topic, similar in (
        ("/w_tpyo", "/w_typo"),
        ("/camera/image_raw", "/robot1/camera/image_raw"),
        ("/odom", ""),
        ("/battery_state", ""),
    ):
        assert found(SimilarTopics, graph, Sought(topic)) == similar


@pytest.mark.parametrize(
    ("other", "meant"),
    [
        ("/robot1/scna", True),
        ("/scan", True),
        ("/robot2/robot1/scan", True),
        ("/robot1/scan_filtered", False),
        ("/robot1/front_scan", False),
        ("/robot1/scan/compressed", False),
        ("/robot1/odom", False),
    ],
)
def test_derived_topic_is_no_mistyped_one(other: str, meant: bool) -> None:
    """Nodes derive topics of the same type from a topic; their names have most of its letters."""
    assert is_mistyped("/robot1/scan", other) is meant


@pytest.mark.parametrize(
    ("pattern", "name", "matching", "meant"),
    [
        ("/cam/*", "/camera/image", False, True),
        ("/cam/**", "/camera/front/image", False, True),
        ("/cam/*", "/robot1/cam/image", False, True),
        ("/robot1/cam/*", "/cam/image", False, True),
        ("/cam*/image", "/lidar/image", False, False),
        ("/cam/*", "/lidar/image", False, False),
        ("/cam/*", "/cam/front/image", False, False),
        ("/cam/*", "/cam/image", False, False),
        ("/cam/*", "/cam/image", True, True),
        ("/**", "/cam/image", True, False),
        ("/cam/*", "/camera/_hidden", False, False),
    ],
)
def test_pattern_that_matches_nothing_may_mean_this(pattern: str, name: str, matching: bool, meant: bool) -> None:
    assert found(MeantNames, _Topics(name), Meant("topic", pattern, matching)) == (name if meant else "")


@pytest.mark.parametrize(
    ("kind", "pattern", "meant"),
    [
        ("service", "/dock/*", "/docks/stop"),
        ("service", "/docks/stop/**", ""),
        ("service", "/docks/go*", ""),
        ("action", "/dock/*", "/docks/go"),
        ("parameters", "/dock/*", "/docks/server"),
        ("topic", "/dock/*", ""),
    ],
)
def test_pattern_means_names_of_its_kind(kind: Kind, pattern: str, meant: str) -> None:
    assert found(MeantNames, _Typed(), Meant(kind, pattern, matching=False)) == meant


class _Lidar(NoRos):
    """A graph of these topics: the type of each, and its publisher."""

    def __init__(self, **topics: tuple[str, str]) -> None:
        self.published = {f"/{name.replace('__', '/')}": ends for name, ends in topics.items()}

    def topics(self) -> dict[str, list[str]]:
        return {topic: [type_name] for topic, (type_name, _) in self.published.items()}

    def publishers(self, topic: str) -> list[Endpoint]:
        type_name, node = self.published[topic]
        return [Endpoint(node, type_name, "", Qos())]


SCAN, TEXT = "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
LIDAR = frozenset({"/lidar"})


@pytest.mark.parametrize(
    ("sought", "topics", "meant"),
    [
        (Sought("/robot1/scan"), {"scan": (SCAN, "/lidar")}, "/scan"),
        (Sought("/scan"), {"robot1__scan": (SCAN, "/lidar")}, "/robot1/scan"),
        (Sought("/scan"), {"robot1__scan": (SCAN, "/lidar"), "robot2__scan": (SCAN, "/lidar")}, ""),
        (Sought("/scan", SCAN), {"front_laser": (SCAN, "/lidar"), "odom": (TEXT, "/lidar")}, "/front_laser"),
        (Sought("/scan", SCAN), {"front_laser": (SCAN, "/lidar"), "rear_laser": (SCAN, "/lidar")}, ""),
        (Sought("/chat", TEXT), {"robot_description": (TEXT, "/robot_state_publisher")}, ""),
        (Sought("/chat", TEXT, LIDAR), {"words": (TEXT, "/lidar"), "robot_description": (TEXT, "/other")}, "/words"),
        (Sought("/chat", TEXT, LIDAR), {"chart": (TEXT, "/other")}, ""),
    ],
)
def test_other_namespace_and_same_type_are_found(
    sought: Sought, topics: dict[str, tuple[str, str]], meant: str
) -> None:
    assert found(SimilarTopics, _Lidar(**topics), sought) == meant


def test_one_search_a_second_whoever_asks() -> None:
    graph = _Topics("/topic0")

    async def ask() -> str:
        similar = SimilarTopics(graph, asyncio.get_running_loop())
        for _ in range(100):
            for number in range(1, 50):
                similar.of(Sought(f"/topic{number}"), lambda: None)
            await asyncio.sleep(0.1)
        return similar.of(Sought("/topic1"), lambda: None)

    with virtual_loop() as loop:
        assert loop.run_until_complete(ask()) == "/topic0"
    assert graph.asked <= 10


def test_search_among_many_names_leaves_the_loop_to_others() -> None:
    graph = _Topics(*(f"/robot{number}/image_raw" for number in range(1000)))

    async def turns() -> int:
        similar, passed = SimilarTopics(graph, asyncio.get_running_loop()), 0
        while not similar.of(Sought("/robot7/image_rwa"), lambda: None):
            passed += 1
            await asyncio.sleep(0)
        return passed

    assert asyncio.run(turns()) >= 20


def test_search_that_fails_keeps_no_other_from_being_made() -> None:
    graph = _Topics("/w_typo")

    def fail() -> dict[str, list[str]]:
        raise RosError("no graph")

    async def ask() -> tuple[str, str]:
        similar = SimilarTopics(graph, asyncio.get_running_loop())
        works, graph.topics = graph.topics, fail  # type: ignore[method-assign]
        before = await answered(similar, Sought("/w_tpyo"))
        graph.topics = works  # type: ignore[method-assign]
        await asyncio.sleep(20)
        return before, await answered(similar, Sought("/w_tpyo"))

    with virtual_loop() as loop:
        assert loop.run_until_complete(ask()) == ("", "/w_typo")
