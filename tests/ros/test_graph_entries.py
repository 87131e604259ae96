"""The callable entries of a graph: services, actions and nodes with parameters, each whole as one entry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_graph import MOST_ENTRIES, called_in
from rsb_bridge.ros.ros_interface import Endpoint

if TYPE_CHECKING:
    from rsb_bridge.model.session import Kind
    from rsb_bridge.model.snapshot import TopicInfo

KINDS: tuple[Kind, ...] = ("service", "action", "parameters")
TRIGGER = "std_srvs/srv/Trigger"


class Services(NoRos):
    """A graph with services.

    Attributes:
        asked: the services whose servers or callers somebody asked for.
    """

    def __init__(self) -> None:
        self._ends: dict[str, tuple[list[Endpoint], list[Endpoint]]] = {}
        self._types: dict[str, list[str]] = {}
        self.asked: list[str] = []

    def add(
        self, name: str, type_name: str, *, servers: int = 1, callers: int = 0, type_hash: str = "RIHS01_1"
    ) -> None:
        ends = self._ends.setdefault(name, ([], []))
        for which, count in zip(ends, (servers, callers), strict=True):
            which.extend([Endpoint("/node", type_name, type_hash, Qos())] * count)
        if type_name not in self._types.setdefault(name, []):
            self._types[name].append(type_name)

    def add_whole(self, kind: Kind, name: str, type_name: str = "", **ends: Any) -> None:
        for lane in LANES[kind]:
            if not lane.is_topic:
                self.add(name + lane.suffix, lane.type_name or type_name + lane.type_suffix, **ends)

    def services(self) -> dict[str, list[str]]:
        return self._types

    def servers(self, service: str) -> list[Endpoint]:
        self.asked.append(service)
        return self._ends[service][0]

    def callers(self, service: str) -> list[Endpoint]:
        return self._ends[service][1]

    def found(self, *kinds: Kind) -> dict[tuple[Kind, str], TopicInfo]:
        return {(each.kind, each.topic): each for each in called_in(self, kinds or KINDS)}


def test_a_service_says_who_has_it() -> None:
    graph = Services()
    graph.add("/reset", TRIGGER, servers=1, callers=2)
    graph.add("/awaited", TRIGGER, servers=0, callers=1, type_hash="RIHS01_2")
    found = graph.found()
    assert found.keys() == {("service", "/reset"), ("service", "/awaited")}
    reset, awaited = found["service", "/reset"], found["service", "/awaited"]
    assert (reset.type_name, reset.type_hash, reset.qos) == (TRIGGER, "RIHS01_1", None)
    assert (reset.publishers, reset.subscriptions) == (1, 2)
    assert (awaited.publishers, awaited.subscriptions, awaited.type_hash) == (0, 1, "RIHS01_2")


def test_servers_that_disagree_about_the_type() -> None:
    graph = Services()
    graph.add("/reset", TRIGGER)
    graph.add("/reset", "std_srvs/srv/Empty")
    assert graph.found()["service", "/reset"].type_name == ""


def test_action_is_one_entry_without_its_services() -> None:
    graph = Services()
    graph.add_whole("action", "/robot1/fibonacci", "test_msgs/action/Fibonacci", servers=1, callers=2)
    (found,) = graph.found().values()
    assert (found.kind, found.topic, found.type_name) == ("action", "/robot1/fibonacci", "test_msgs/action/Fibonacci")
    assert (found.publishers, found.subscriptions) == (1, 2)
    assert graph.found("service") == {}


def test_node_with_parameters_is_one_entry() -> None:
    graph = Services()
    graph.add_whole("parameters", "/robot1/controller_server")
    graph.add("/robot1/controller_server/get_type_description", "type_description_interfaces/srv/GetTypeDescription")
    graph.add("/robot1/controller_server/change_state", "lifecycle_msgs/srv/ChangeState")
    assert graph.found().keys() == {
        ("parameters", "/robot1/controller_server"),
        ("service", "/robot1/controller_server/change_state"),
    }
    assert graph.found()["parameters", "/robot1/controller_server"].type_name == ""


def test_a_service_may_have_its_nodes_name() -> None:
    graph = Services()
    graph.add_whole("parameters", "/dock")
    graph.add("/dock", TRIGGER)
    assert graph.found().keys() == {("parameters", "/dock"), ("service", "/dock")}


def test_services_that_only_look_like_part_are_services() -> None:
    graph = Services()
    graph.add("/list_parameters", "rcl_interfaces/srv/ListParameters")
    graph.add("/shop/list_parameters", "shop_msgs/srv/ListParameters")
    graph.add("/shop/get_parameters", "rcl_interfaces/srv/GetParameters")
    graph.add("/send_goal", "test_msgs/action/Fibonacci_SendGoal")
    assert {name for _, name in graph.found("service")} == {
        "/list_parameters", "/shop/list_parameters", "/shop/get_parameters", "/send_goal",
    }  # fmt: skip
    assert graph.found("action", "parameters") == {}


def test_hidden_and_incomplete_entries_are_left_out() -> None:
    graph = Services()
    graph.add("/_rsb_bridge/ask", TRIGGER)
    graph.add_whole("parameters", "/_ros2cli_daemon_0")
    graph.add("/odd/_action/send_goal", "odd_msgs/srv/Odd_SendGoal")
    graph.add("/gone", TRIGGER, servers=0)
    assert graph.found() == {}


def test_only_what_is_asked_for_is_looked_at() -> None:
    graph = Services()
    graph.add_whole("action", "/fibonacci", "test_msgs/action/Fibonacci")
    graph.add_whole("parameters", "/node")
    graph.add("/reset", TRIGGER)
    assert graph.found("action").keys() == {("action", "/fibonacci")}
    assert graph.asked == ["/fibonacci/_action/send_goal"]
    assert called_in(graph, ()) == []


def test_endless_graph_is_looked_at_in_part() -> None:
    graph = Services()
    for number in range(MOST_ENTRIES + 100):
        graph.add(f"/service_{number:05}", TRIGGER)
    graph.add_whole("parameters", "/zzz")
    found = graph.found()
    assert len(graph.asked) == len(found) == MOST_ENTRIES + 1
    assert ("parameters", "/zzz") in found
