"""Servers and their types, as the graph shows them."""

from __future__ import annotations

from collections import defaultdict

import pytest

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.ros.stand_in import NoRos
from rsb_bridge.route.calls.call_servers import Provision, UnavailableError, others_called, provision, types_clash
from rsb_bridge.wire.records import LaneEntry

SET = "std_srvs/srv/SetBool"
GOTO = "nav2_msgs/action/NavigateToPose"
ONE, TWO = "RIHS01_1", "RIHS01_2"


class Graph(NoRos):
    """One that has what a test puts into it."""

    def __init__(self) -> None:
        self.at: defaultdict[str, list[Endpoint]] = defaultdict(list)
        self.calls: defaultdict[str, list[Endpoint]] = defaultdict(list)
        self.installed: dict[str, str] = {}

    def serve_by(self, service: str, node: str, type_name: str = SET, type_hash: str = ONE) -> None:
        """Put a server, or a publisher, there."""
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
    lanes = LANES[kind]  # type: ignore[index]
    return provision(graph, lanes, "/go", wanted, 2, lambda lane: graph.servers("/go" + lanes[lane].suffix))


def cause(provided: Provision) -> Cause | None:
    assert not provided.entries or provided.unavailable is None
    return provided.unavailable.cause if provided.unavailable else None


def test_a_service(graph: Graph) -> None:
    assert cause(found(graph)) is Cause.NO_SERVER
    graph.serve_by("/go", "/teller")
    provided = found(graph)
    assert provided.entries == (LaneEntry(SET, ONE, 1),)
    assert provided.warning is None


def test_an_action_is_there_with_all_its_services_and_its_topics_may_follow(graph: Graph) -> None:
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


def test_servers_that_disagree(graph: Graph) -> None:
    graph.serve_by("/go", "/one")
    graph.serve_by("/go", "/two", "std_srvs/srv/Trigger")
    assert cause(found(graph)) is Cause.TYPE_CONFLICT
    graph.at.clear()
    graph.serve_by("/go", "/one")
    graph.serve_by("/go", "/two", type_hash=TWO)
    provided = found(graph)
    assert cause(provided) is Cause.TYPE_CONFLICT
    assert provided.unavailable is not None
    assert "/one" in provided.unavailable.text
    assert "/two" in provided.unavailable.text


def test_the_type_that_the_session_names(graph: Graph) -> None:
    graph.serve_by("/go", "/teller")
    assert found(graph, wanted=SET).entries
    assert cause(found(graph, wanted="std_srvs/srv/Trigger")) is Cause.TYPE_CONFLICT


def test_a_middleware_that_tells_no_hashes(graph: Graph) -> None:
    graph.serve_by("/go", "/teller", type_hash="")
    assert cause(found(graph)) is Cause.TYPE_UNKNOWN
    graph.installed[SET] = ONE
    assert found(graph).entries == (LaneEntry(SET, ONE, 1),)


def test_several_nodes_are_named_and_one_that_was_started_again_is_not(graph: Graph) -> None:
    graph.serve_by("/go", "/teller")
    graph.serve_by("/go", "/teller")
    assert found(graph).warning is None
    graph.serve_by("/go", "/other")
    warning = found(graph).warning
    assert warning is not None
    assert warning.cause is Cause.SEVERAL_SERVERS
    assert "/other and /teller" in warning.text


def test_why_none_may_be_called_is_said_by_whoever_knows(graph: Graph) -> None:
    def servers_of(_: int) -> list[Endpoint]:
        raise UnavailableError(Cause.LOOP, "a circle")

    provided = provision(graph, LANES["service"], "/go", "", 2, servers_of)
    assert cause(provided) is Cause.LOOP


def clash(graph: Graph) -> str:
    entries = (LaneEntry(SET, ONE, 1),)
    trouble = types_clash(graph, LANES["service"], entries, ["/go"], graph.calls, lambda _, installed: installed)
    assert trouble is None or trouble.cause is Cause.TYPE_CONFLICT
    return trouble.text if trouble else ""


def test_types_on_the_callers_side(graph: Graph) -> None:
    assert not clash(graph)
    graph.installed[SET] = ONE
    graph.calls["/go"] = [Endpoint("/asker", SET, ONE, Qos()), Endpoint("/quiet", SET, "", Qos())]
    assert not clash(graph)
    graph.calls["/go"].append(Endpoint("/old", SET, TWO, Qos()))
    assert "/old" in clash(graph)
    graph.calls["/go"] = [Endpoint("/wrong", "std_srvs/srv/Trigger", ONE, Qos())]
    assert "/wrong" in clash(graph)
    graph.calls["/go"].append(Endpoint("/asker", SET, ONE, Qos()))
    assert not clash(graph)
    others = others_called(LANES["service"], (LaneEntry(SET, ONE, 1),), ["/go"], graph.calls)
    assert others is not None
    assert "/wrong" in others.text
    assert "/asker" not in others.text
    graph.calls.clear()
    graph.installed[SET] = TWO
    assert TWO in clash(graph)
