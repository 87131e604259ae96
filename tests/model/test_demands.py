"""Names that a session demands to be armed, by entries, patterns and `armed`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.model.demands import (
    Demand,
    Demands,
    OriginText,
    RunningDemands,
    as_armed,
    describe,
    sources_of,
    sources_of_entries,
)
from rsb_bridge.model.session import DEADMAN, ArmedName, Client, Kind, Session, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.demands import DemandSource

RENAMED = Topic("/a/*", "receive", remote_topic="/b/*", arm=True, excepts=("/a/x",))


def client(*topics: Topic, armed: tuple[str | ArmedName, ...] = ()) -> Demands:
    session = Session(name="robot1", role="client", server_ip="10.0.0.1", topics=topics, armed=armed)
    return Demands(sources_of(session))


def server(*topics: Topic, use_name: bool) -> Demands:
    clients = (Client("robot1", use_name=use_name, topics=topics),)
    return Demands(sources_of(Session(name="pc", role="server", server_ip="10.0.0.1", clients=clients)))


@pytest.mark.parametrize(
    ("demands", "name", "expected"),
    [
        (client(Topic("/cmd", "receive", arm=True)), "/cmd", True),
        (client(Topic("/cmd", "transmit", arm=True)), "/cmd", True),
        (client(Topic("/cmd", "receive")), "/cmd", False),
        (client(Topic("/**", "receive"), Topic("/cmd*", "receive", arm=True)), "/cmd_vel", True),
        (client(Topic("/cmd*", "receive", arm=True), Topic("/cmd_vel", "receive")), "/cmd_vel", True),
        (client(Topic("/cmd*", "receive", arm=True, excepts=("/cmd_log",))), "/cmd_log", False),
        (client(armed=("/cmd",)), "/cmd", True),
        (client(armed=("/cmd/**",)), "/cmd/a/b", True),
        (client(Topic("/cmd", "receive", remote_topic="/far", arm=True)), "/far", False),
        (server(Topic("/cmd", "receive", remote_topic="/far", arm=True), use_name=True), "/far", True),
        (server(Topic("/cmd", "receive", arm=True), use_name=True), "/robot1/cmd", True),
        (server(Topic("/cmd", "receive", arm=True), use_name=True), "/cmd", False),
        (server(Topic("/cmd*", "receive", arm=True), use_name=True), "/robot1/cmd_vel", True),
        (server(RENAMED, use_name=False), "/b/x", False),
        (server(RENAMED, use_name=False), "/b/y", True),
    ],
)  # fmt: skip
def test_every_line_that_matches_counts(demands: Demands, name: str, expected: bool) -> None:
    assert (demands.of("topic", name) is not None) is expected


@pytest.mark.parametrize(
    ("entry", "client_name", "expected"),
    [
        (Topic("/cmd*", "receive", arm=True), "/cmd_vel", True),
        (Topic("/cmd", "receive", arm=True), "/cmd", True),
        (Topic("/cmd", "receive", arm=True), "/other", False),
        (Topic("/cmd*", "receive", arm=True, excepts=("/cmd_log",)), "/cmd_log", False),
        (Topic("/arm", "receive", kind="action", arm=True), "/arm/_action/send_goal", True),
    ],
)
def test_a_client_that_bridges_a_name_to_another_one_ends_no_demand(
    entry: Topic, client_name: str, expected: bool
) -> None:
    demands = server(entry, use_name=True)
    kind: Kind = "service" if entry.kind == "action" else "topic"
    assert (demands.of(kind, "/far", client="robot1", client_name=client_name) is not None) is expected
    assert demands.of(kind, "/far", client="robot2", client_name=client_name) is None
    assert demands.of(kind, "/far") is None


@pytest.mark.parametrize(
    ("listed", "kind", "name", "expected"),
    [
        ("parameters", "service", "/arm/set_parameters", True),
        ("parameters", "service", "/arm/reset", False),
        ("service", "topic", "/arm", False),
        ("action", "service", "/arm/_action/send_goal", True),
        ("action", "service", "/arm/_action/cancel_goal", False),
        ("topic", "topic", "/arm", True),
    ],
)
def test_a_service_has_the_demands_of_what_it_belongs_to(listed: Kind, kind: Kind, name: str, expected: bool) -> None:
    demands = client(Topic("/arm", "receive", kind=listed, arm=True))
    assert (demands.of(kind, name) is not None) is expected
    assert client(armed=("/arm",)).of(listed, "/arm") is not None, "of every kind"


def test_a_pattern_of_a_type_counts_unless_the_name_is_known_to_have_another() -> None:
    demands = client(Topic("/**", "receive", type="Twist", arm=True))
    assert demands.of("topic", "/cmd") is not None
    assert demands.of("topic", "/cmd", "geometry_msgs/msg/Twist") is not None
    assert demands.of("topic", "/odom", "nav_msgs/msg/Odometry") is None


@pytest.mark.parametrize(("times", "shortest"), [((None, 5.0), 5.0), ((0.0, 7.0), 7.0), ((0.0, 0.0), 0.0)])
def test_the_shortest_deadman_that_is_not_0_counts(times: tuple[float | None, float], shortest: float) -> None:
    one, other = times
    demand = client(Topic("/cmd", "receive", arm=True, deadman=one), Topic("/c*", "transmit", arm=True, deadman=other))
    found = demand.of("topic", "/cmd")
    assert found is not None
    assert (found.deadman, len(found.sources)) == (shortest, 2)


CMD = Topic("/cmd", "receive", arm=True)
PATTERN = Topic("/cmd*", "receive", arm=True)


@pytest.mark.parametrize(
    ("before", "after", "kept"),
    [
        ((CMD,), (), ["/cmd"]),
        ((CMD,), (Topic("/cmd", "receive"),), ["/cmd"]),
        ((CMD,), (Topic("/cmd2", "receive", arm=True),), ["/cmd"]),
        ((CMD,), (Topic("/cmd", "transmit", arm=True),), []),
        ((CMD,), (Topic("/cmd", "receive", kind="service", arm=True),), ["/cmd"]),
        ((CMD,), (PATTERN,), []),
        ((Topic("/cmd", "receive", arm=True, deadman=5.0),), (PATTERN,), [ArmedName("/cmd", deadman=5.0)]),
        ((Topic("/cmd", "receive", arm=True, deadman=5.0),), (CMD,), []),
        ((PATTERN,), (), [ArmedName("/cmd*", "topic")]),
        ((PATTERN,), (Topic("/cmd*", "receive", arm=True, excepts=("/cmd_a",)),), ["/cmd_a"]),
        ((PATTERN,), (Topic("/cmd*", "transmit", arm=True),), []),
        ((PATTERN,), (Topic("/cmd_*", "receive", arm=True),), [ArmedName("/cmd*", "topic")]),
    ],
)
def test_what_has_to_be_kept(before: tuple[Topic, ...], after: tuple[Topic, ...], kept: list[str | ArmedName]) -> None:
    missing = client(*after).missing(client(*before).sources)
    found = [as_armed(each) for rest in missing.values() for each in rest]
    assert found == kept
    whole = client(*after, armed=tuple(found))
    assert whole.missing(client(*before).sources) == {}, "the kept demands cover the old ones"


def test_the_line_is_named() -> None:
    (one,), (other,) = client(CMD).sources, client(PATTERN).sources
    assert describe(one, {one.key: "robot.yaml:14"}) == "robot.yaml:14"
    assert describe(other, {other.key: "robot.yaml:20"}) == OriginText.PATTERN_IN_FILE(
        pattern="/cmd*", place="robot.yaml:20"
    )
    assert one.deadman == DEADMAN
    assert client(CMD).of("topic", "/cmd") == Demand(DEADMAN, 1.0, (one,))


class Entries:
    """A link of a server, with the entries of its client."""

    def __init__(self, name: str, topics: tuple[Topic, ...]) -> None:
        self.name, self.topics = name, topics

    def demand_sources(self) -> Iterator[DemandSource]:
        return sources_of_entries(self.topics, self.name, on_server=True, use_name=True)

    def apply_demands(self) -> None:
        pass

    def demand_dropped(self, source: DemandSource) -> None:
        pass


def test_a_change_costs_a_server_of_many_robots_little() -> None:
    """A server of 60 robots stood still for 0.9 s whenever a route went."""
    demands = RunningDemands(lambda: (), lambda _: None, lambda: None, lambda *_: None, lambda *_: None)
    patterns = tuple(Topic(f"/cmd{number}*", "receive", arm=True) for number in range(20))
    for number in range(60):
        demands.register(Entries(f"robot{number}", patterns))
    demands.of("topic", "/cmd")
    began = time.process_time()
    for _ in range(10):
        demands.changed()
        found = demands.of("topic", "/robot3/cmd7_vel", client="robot3", client_name="/cmd7_vel")
        assert found is not None
        assert len(found.sources) == 1
    assert time.process_time() - began < 1.0
