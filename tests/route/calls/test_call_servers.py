"""Servers and their types, as the graph shows them."""

from __future__ import annotations

from collections import defaultdict
from types import SimpleNamespace
from typing import Any

import pytest

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.calls.call_servers import Provision, UnavailableError, provision
from rsb_bridge.wire.records import LaneEntry

SET = "std_srvs/srv/SetBool"
GOTO = "nav2_msgs/action/NavigateToPose"
ONE, TWO = "RIHS01_1", "RIHS01_2"


class Graph(NoRos):
    def __init__(self) -> None:
        self.at: defaultdict[str, list[Endpoint]] = defaultdict(list)
        self.calls: defaultdict[str, list[Endpoint]] = defaultdict(list)
        self.installed: dict[str, str] = {}

    def serve_by(self, service: str, node: str, type_name: str = SET, type_hash: str = ONE) -> None:
        gid = f"{node}{service}{len(self.at[service])}".encode()
        self.at[service].append(Endpoint(node, type_name, type_hash, Qos(), gid))

    def servers(self, service: str) -> list[Endpoint]:
        return self.at[service]

    def publishers(self, topic: str) -> list[Endpoint]:
        return self.at[topic]

    def callers(self, service: str) -> list[Endpoint]:
        return self.calls[service]

    def installed_hash(self, type_name: str) -> str | None:
        return self.installed.get(type_name)

    def installed_service_hash(self, type_name: str) -> str | None:
        return self.installed.get(type_name)


@pytest.fixture
def graph() -> Graph:
    return Graph()


def found(graph: Graph, kind: str = "service", wanted: str = "") -> Provision:
    guard: Any = SimpleNamespace(servers=lambda service, _: graph.servers(service))
    return provided(graph, kind, wanted, guard)


def provided(graph: Graph, kind: str, wanted: str, guard: Any) -> Provision:
    context: Any = SimpleNamespace(ros=graph, domain="2", domain_id=2)
    return provision(context, LANES[kind], "/go", "/far/go", wanted, guard)  # type: ignore[index]


def cause(found: Provision) -> Cause | None:
    assert not found.entries or found.unavailable is None
    return found.unavailable.cause if found.unavailable else None


def test_action_needs_services_topics_may_follow(graph: Graph) -> None:
    for lane in LANES["action"][:3]:
        assert cause(found(graph, "action")) is Cause.NO_SERVER
        graph.serve_by("/go" + lane.suffix, "/navigator", lane.type_name or GOTO + lane.type_suffix)
    entries = found(graph, "action").entries
    assert [entry.type for entry in entries] == [
        f"{GOTO}_SendGoal",
        "action_msgs/srv/CancelGoal",
        f"{GOTO}_GetResult",
        f"{GOTO}_FeedbackMessage",
        "action_msgs/msg/GoalStatusArray",
    ]
    assert [entry.type_hash for entry in entries] == [ONE, ONE, ONE, "", ""]
    graph.serve_by("/go/_action/feedback", "/navigator", f"{GOTO}_FeedbackMessage", TWO)
    graph.serve_by("/go/_action/feedback", "/stranger", "std_msgs/msg/String", ONE)
    feedback = found(graph, "action").entries[3]
    assert (feedback.type_hash, feedback.providers) == (TWO, 1)


def test_a_middleware_that_tells_no_hashes(graph: Graph) -> None:
    graph.serve_by("/go", "/teller", type_hash="")
    assert cause(found(graph)) is Cause.TYPE_UNKNOWN
    graph.installed[SET] = ONE
    assert found(graph).entries == (LaneEntry(SET, ONE, 1),)


def test_several_servers_are_named_restarted_one_is_not(graph: Graph) -> None:
    graph.serve_by("/go", "/teller")
    graph.serve_by("/go", "/teller")
    assert found(graph).warning is None
    graph.serve_by("/go", "/other")
    warning = found(graph).warning
    assert warning is not None
    assert warning.cause is Cause.SEVERAL_SERVERS
    assert "/other and /teller" in warning.text


def test_reason_against_call_is_told_by_knowing_side(graph: Graph) -> None:
    def servers(service: str, callers_name: str) -> list[Endpoint]:
        assert (service, callers_name) == ("/go", "/far/go")
        raise UnavailableError(Cause.LOOP, "a circle")

    assert cause(provided(graph, "service", "", SimpleNamespace(servers=servers))) is Cause.LOOP
