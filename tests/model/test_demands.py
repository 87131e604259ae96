"""Names that a session demands to be armed, by entries, patterns and `armed`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support.steps import counted

from rsb_bridge.model.demands import (
    Demand,
    Demands,
    OriginText,
    RunningDemands,
    all_armed,
    armed_line,
    describe,
    sources_of,
    sources_of_entries,
    sources_of_topics,
)
from rsb_bridge.model.session import DEADMAN, ArmedName, Client, Kind, Session, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.demands import DemandSource

RENAMED = Topic("/a/*", "receive", remote_topic="/b/*", arm=True, excepts=("/a/x",))


def session(*topics: Topic, armed: tuple[str | ArmedName, ...] = ()) -> Session:
    return Session(name="robot1", role="client", server_ip="10.0.0.1", topics=topics, armed=armed)


def client(*topics: Topic, armed: tuple[str | ArmedName, ...] = ()) -> Demands:
    return Demands(sources_of(session(*topics, armed=armed)))


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
def test_renaming_client_ends_no_demand(entry: Topic, client_name: str, expected: bool) -> None:
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
def test_service_has_demands_of_what_it_belongs_to(listed: Kind, kind: Kind, name: str, expected: bool) -> None:
    demands = client(Topic("/arm", "receive", kind=listed, arm=True))
    assert (demands.of(kind, name) is not None) is expected
    assert client(armed=("/arm",)).of(listed, "/arm") is not None, "of every kind"


def test_pattern_of_type_counts_for_unknown_types() -> None:
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


class Entries:
    """A link of a server, or a client's, with the entries of its side."""

    def __init__(self, name: str, topics: tuple[Topic, ...]) -> None:
        self.name, self.topics = name, topics
        self.told: list[str] = []
        self.applied = 0

    def demand_sources(self) -> Iterator[DemandSource]:
        return sources_of_entries(self.topics, self.name, on_server=bool(self.name), use_name=True)

    def apply_demands(self) -> None:
        self.applied += 1

    def demand_dropped(self, source: DemandSource) -> None:
        self.told.append(source.name)


class Running:
    """The demands of a client's running session.

    Attributes:
        armed_in_file: `armed` of the session's file.
        dropped: names of which operators read that their demand is dropped.
    """

    def __init__(self, *topics: Topic, armed: tuple[str | ArmedName, ...] = (), client: str = "") -> None:
        self.session = session(*topics, armed=armed)
        self.armed_in_file = armed
        self.entries = Entries(client, topics)
        self.dropped: list[str] = []
        self.demands = RunningDemands(self)
        self.demands.register(self.entries)
        self.demands.apply()

    @property
    def armed(self) -> tuple[str | ArmedName, ...]:
        return self.session.armed

    def demands_changed(self) -> None:
        """The test applies changes itself."""

    def demand_dropped(self, source: DemandSource, origin: str) -> None:
        self.dropped.append(source.name)

    def edit(self, *topics: Topic) -> None:
        self.entries.topics = topics
        self.demands.changed()

    def end(self, *names: str) -> None:
        """End demands, as an operator has agreed to."""
        self.demands.end([each for each in self.demands.read().sources if each.name in names])

    def demanded(self, name: str, kind: Kind = "topic") -> float | None:
        """The deadman of a name that has to be armed, or None."""
        found = self.demands.read().of(kind, name)
        return found.deadman if found is not None and found.arm else None


GO = ArmedName("/cmd", "topic")
GO_ALL = ArmedName("/cmd*", "topic")


@pytest.mark.parametrize(
    ("before", "after", "written"),
    [
        ((CMD,), (), [GO]),
        ((CMD,), (Topic("/cmd", "receive"),), [GO]),
        ((CMD,), (Topic("/cmd", "receive", max_age=5.0),), [GO]),
        ((CMD,), (Topic("/cmd2", "receive", arm=True),), [GO]),
        ((CMD,), (Topic("/cmd", "transmit", arm=True),), []),
        ((CMD,), (Topic("/cmd", "receive", kind="service", arm=True),), [GO]),
        ((CMD,), (PATTERN,), [GO]),
        ((Topic("/cmd", "receive", arm=True, deadman=5.0),), (), [ArmedName("/cmd", "topic", deadman=5.0)]),
        ((CMD, Topic("/cmd", "transmit", arm=True)), (), [GO]),
        ((Topic("/cmd", "receive", arm=True, deadman=5.0),), (CMD,), [ArmedName("/cmd", "topic", deadman=5.0)]),
        ((PATTERN,), (), [GO_ALL]),
        ((PATTERN,), (Topic("/cmd*", "receive", arm=True, excepts=("/cmd_a",)),), [GO_ALL]),
        ((PATTERN,), (Topic("/cmd*", "receive", arm=True, type="Twist"),), [GO_ALL]),
        ((Topic("/c/*", "receive", arm=True, excepts=("/c/a",)),), (), [ArmedName("/c/*", "topic", excepts=("/c/a",))]),
        ((Topic("/c/*", "receive", arm=True, excepts=("/c/a",)),),
         (Topic("/c/*", "receive", arm=True, excepts=("/c/a", "/c/b*")),),
         [ArmedName("/c/*", "topic", excepts=("/c/a",))]),
        ((Topic("/c/*", "receive", arm=True, excepts=("/c/a",)),), (Topic("/c/*", "receive", arm=True),), []),
        ((PATTERN,), (Topic("/cmd_*", "receive", arm=True),), [GO_ALL]),
        ((Topic("/cmd", "receive", max_age=5.0),), (), []),
    ],
)  # fmt: skip
def test_what_an_entry_demanded_stays(
    before: tuple[Topic, ...], after: tuple[Topic, ...], written: list[str | ArmedName]
) -> None:
    """A name once demanded stays so, even without its entries, and as carefully."""
    running = Running(*before)
    names = [each for each in ("/cmd", "/cmd_a", "/cmd_x", "/c/b", "/c/x") if running.demanded(each) is not None]
    running.edit(*after)
    assert [each for each in names if running.demanded(each) is None] == []
    running.demands.apply()
    assert list(running.demands.written) == written
    running.edit()
    assert [each for each in names if running.demanded(each) is None] == []


def test_armed_has_the_lines_of_all_entries() -> None:
    other = Topic("/other", "receive", arm=True, deadman=5.0)
    running = Running(CMD, other, Topic("/scan", "transmit", max_age=1.0), armed=("/line",))
    assert running.armed == ("/line", GO, ArmedName("/other", "topic", deadman=5.0))
    assert running.demands.written == ("/line",)
    running.edit(CMD)
    running.demands.apply()
    assert running.armed == ("/line", GO, ArmedName("/other", "topic", deadman=5.0))
    assert list(running.demands.written) == ["/line", ArmedName("/other", "topic", deadman=5.0)]


def line(topic: Topic) -> DemandSource:
    (source,) = sources_of_entries((topic,), "", on_server=False, use_name=False)
    return armed_line(source)


@pytest.mark.parametrize(
    ("others", "armed", "expected"),
    [
        ((), (), 60.0),
        ((), ("/cmd",), 60.0),
        ((), (ArmedName("/cmd", deadman=3.0),), 3.0),
        ((), (ArmedName("/cmd", "topic", deadman=5.0),), 5.0),
        ((), (ArmedName("/cmd", "topic", deadman=3.0),), 3.0),
        ((Topic("/cmd", "transmit", arm=True, deadman=5.0),), (), 5.0),
        ((Topic("/cmd", "transmit", arm=True, deadman=7.0),), (), 7.0),
        ((Topic("/c*", "receive", arm=True, deadman=5.0),), (), 5.0),
    ],
)
def test_edit_changes_only_what_its_entry_demands(
    others: tuple[Topic, ...], armed: tuple[str | ArmedName, ...], expected: float
) -> None:
    old, new = Topic("/cmd", "receive", arm=True, deadman=5.0), CMD
    running = Running(old, *others, armed=armed)
    running.edit(new, *others)
    running.demands.edited(line(old), line(new))
    assert running.demanded("/cmd") == expected
    assert running.demands.written == armed


def test_edit_makes_no_kept_deadman_longer() -> None:
    running = Running(Topic("/cmd", "receive", arm=True, deadman=5.0))
    running.edit()
    running.edit(CMD)
    assert running.demanded("/cmd") == 5.0
    new = msgspec.structs.replace(CMD, deadman=90.0)
    running.edit(new)
    running.demands.edited(line(CMD), line(new))
    assert running.demanded("/cmd") == 5.0


def test_line_of_session_stays_as_written() -> None:
    """A file may list the same name twice, in an entry and under `armed`, and more carefully in one of them."""
    running = Running(CMD, armed=(GO,))
    assert (running.armed, running.demands.written) == ((GO,), (GO,))
    running.edit(msgspec.structs.replace(CMD, deadman=0.0))
    assert running.demanded("/cmd") == DEADMAN
    assert running.demands.written == (GO,)
    careful = Running(msgspec.structs.replace(CMD, deadman=5.0), armed=(GO,))
    assert (careful.demanded("/cmd"), careful.demands.written) == (5.0, (GO,))


@pytest.mark.parametrize("entry", [CMD, PATTERN])
def test_servers_removed_entry_counts_under_clients_name(entry: Topic) -> None:
    """A client that bridged the name to another one of the server was free of it once the entry was removed."""
    running = Running(entry, client="robot1")
    running.edit()
    find = running.demands.read().of
    assert find("topic", "/far", client="robot1", client_name="/cmd") is not None
    assert find("topic", "/far", client="robot2", client_name="/cmd") is None
    assert find("topic", "/robot1/cmd") is not None


def test_exceptions_one_by_one_leave_one_line() -> None:
    running = Running(PATTERN)
    names = tuple(f"/cmd_{number}" for number in range(20))
    for number in range(1, len(names)):
        running.edit(msgspec.structs.replace(PATTERN, excepts=names[:number]))
        assert None not in map(running.demanded, names)
    assert running.demands.written == (GO_ALL,)


def test_stricter_line_is_kept_beside_wider() -> None:
    """The other side removed a pattern's topic, and its deadman became longer."""
    running = Running(PATTERN)
    for excepts, deadman in (("/cmd_a",), None), (("/cmd_a",), 5.0), (("/cmd_a", "/cmd_b"), 5.0):
        running.edit(msgspec.structs.replace(PATTERN, excepts=excepts, deadman=deadman))
        running.demands.apply()
    assert running.demanded("/cmd_b") == 5.0


def test_another_session_takes_no_line_out() -> None:
    running = Running(CMD, armed=("/other", "/edited"))
    running.demands.use(session(Topic("/comes", "receive", arm=True), armed=(ArmedName("/edited", deadman=5.0),)))
    assert running.demanded("/comes") == DEADMAN, "before its entry comes"
    assert running.demanded("/other") == DEADMAN
    assert running.demanded("/edited") == 5.0
    running.edit()
    assert running.demanded("/cmd") == DEADMAN


def test_only_operator_ends_demand() -> None:
    running = Running(CMD, armed=("/other",))
    running.edit()
    running.demands.tell_end([each for each in running.demands.read().sources if each.name == "/cmd"])
    assert running.entries.told == ["/cmd"]
    assert running.demanded("/cmd") is not None, "not before the end"
    running.end("/cmd")
    assert running.demanded("/cmd") is None
    assert (running.armed, running.dropped) == (("/other",), ["/cmd"])
    running.end("/other")
    assert (running.armed, running.dropped) == ((), ["/cmd", "/other"])
    assert running.demands.written == ()


def test_what_comes_and_goes_during_change_was_demanded() -> None:
    """A reload adds an entry, and before it is through, the other side opens its route and removes it."""
    running = Running()
    with running.demands.changing():
        running.edit(CMD)
        running.demands.apply()
        running.edit()
    assert running.demanded("/cmd") is not None
    assert running.armed == (GO,)


def test_removed_link_leaves_demands_that_nobody_read() -> None:
    running = Running()
    running.edit(CMD)
    running.demands.unregister(running.entries)
    assert running.demanded("/cmd") is not None


def test_changes_are_applied_once_at_their_end() -> None:
    running = Running()
    with running.demands.changing():
        running.edit(CMD)
        running.demands.apply()
        assert running.entries.applied == 1
    assert running.entries.applied == 2


def test_end_of_demand_leaves_that_of_its_entry() -> None:
    running = Running(CMD)
    running.end("/cmd")
    assert running.demanded("/cmd") is not None
    assert running.dropped == []


def test_demands_beyond_other_sessions_lines_are_named() -> None:
    """An entry, a line of `armed`, and a name that a pattern leaves out; one with another deadman is edited."""
    edited = Topic("/edit", "receive", arm=True, deadman=5.0)
    running = Running(CMD, PATTERN, edited, armed=("/other", "/same"))
    topics = (
        msgspec.structs.replace(PATTERN, excepts=("/cmd_a",)),
        msgspec.structs.replace(edited, deadman=60.0),
    )
    other = session(*topics, armed=("/same",))
    ended = running.demands.ended_by(other)
    assert sorted(each.name for each in ended) == ["/cmd", "/cmd*", "/other"]
    running.demands.use(other)
    running.edit(*topics)
    running.armed_in_file = ("/same",)
    running.demands.end(ended, all_armed(other.armed, sources_of_topics(other)).values())
    assert running.demands.written == ("/same",)
    assert (running.demanded("/cmd_a"), running.demanded("/edit"), running.demanded("/other")) == (None, 60.0, None)
    assert running.demanded("/cmd_b") is not None


def test_the_line_is_named() -> None:
    (one,), (other,) = client(CMD).sources, client(PATTERN).sources
    assert describe(one, {one.key: "robot.yaml:14"}) == "robot.yaml:14"
    assert describe(other, {other.key: "robot.yaml:20"}) == OriginText.PATTERN_IN_FILE(
        pattern="/cmd*", place="robot.yaml:20"
    )
    assert one.deadman == DEADMAN
    assert client(CMD).of("topic", "/cmd") == Demand(DEADMAN, 1.0, (one,))


def test_line_that_no_file_has_is_named() -> None:
    running = Running(CMD)
    (added,) = running.demands.read().sources
    assert running.demands.origin(added) == OriginText.THIS_SESSION()
    running.demands.set_places({added.key: "robot.yaml:14"})
    assert running.demands.origin(added) == "robot.yaml:14"


def test_change_costs_server_of_many_robots_little() -> None:
    """A server of 60 robots stood still for 0.9 s whenever a route went."""
    demands = Running().demands
    patterns = tuple(Topic(f"/cmd{number}*", "receive", arm=True) for number in range(20))
    for number in range(60):
        demands.register(Entries(f"robot{number}", patterns))
    demands.read()

    def change() -> Demand | None:
        demands.changed()
        return demands.read().of("topic", "/robot3/cmd7_vel", client="robot3", client_name="/cmd7_vel")

    found, calls = counted(change)
    assert found is not None
    assert len(found.sources) == 1
    assert calls < 30 * 60 * len(patterns)
