"""A session's `limits`: read, checked, shown with its line, written, and kept."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from tests.config.mistakes import problems

from rsb_bridge.config.session_file import demand_places, load_file, save
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.demands import Demands, as_armed, most_careful, sources_of
from rsb_bridge.model.session import ArmedName, Session, Topic
from rsb_console.command.check import SessionCheckText, summary
from rsb_console.session.draft import problems_of, topic_of, values_of

FILE = """\
name: r
role: client
server_ip: 10.0.0.1
server_port: 5
use_encryption: false
armed: [{name: /turn, limits: {angular: 0.3}}]
topics:
  - {topic: /cmd_vel, direction: receive, arm: true, limits: {linear: 0.5, angular: 1}}
  - {topic: /turn, direction: receive, limits: {linear: 0.2, angular: 2}}
  - {topic: "/b/**", direction: receive, type: TwistStamped, limits: {linear: 2}}
"""
LIMITS = VelocityLimits(0.5, 1.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "robot.yaml"
    made.write_text(FILE)
    return made


def test_what_is_saved_is_what_is_read(path: Path) -> None:
    opened = load_file(path)
    first, *others = opened.session.topics
    assert first.limits == LIMITS
    slower = msgspec.structs.replace(first, limits=VelocityLimits(0.1))
    armed = (*opened.session.armed, ArmedName("/d", limits=LIMITS))
    new = msgspec.structs.replace(opened.session, topics=(slower, *others), armed=armed)
    save(new, path, opened)
    assert load_file(path).session == new


@pytest.mark.parametrize(
    ("entry", "key"),
    [
        ("limits: 0.5", "limits"),
        ("limits: {}", "limits"),
        ("limits: {linear: 0}", "limits.linear"),
        ("limits: {linear: -1}", "limits.linear"),
        ("limits: {linear: .nan}", "limits.linear"),
        ("limits: {linear: 1, angular: .inf}", "limits.angular"),
        ("limits: {linear: fast}", "limits.linear"),
        ("limits: {linear: true}", "limits.linear"),
        ("limits: {x: 0.5}", "limits.x"),
        ("type: String, limits: {linear: 0.5}", "limits"),
        ("type: ackermann_msgs/msg/AckermannDrive, limits: {linear: 0.5}", "limits"),
    ],
)
def test_mistakes_are_located(entry: str, key: str) -> None:
    found = problems(FILE.replace("arm: true, limits: {linear: 0.5, angular: 1}", entry))
    assert {(each.location, each.line) for each in found} == {(f"topics[0].{key}", 8)}


@pytest.mark.parametrize(
    ("old", "new", "location"),
    [
        ("type: TwistStamped, ", "", "topics[2].limits"),
        ("name: /turn, ", "name: /turn, kind: action, ", "armed[0].limits"),
        ("name: /turn, ", "name: /turn, type: String, ", "armed[0].limits"),
        ("name: /turn, ", 'name: "/turn/*", ', "armed[0].limits"),
        ("{angular: 0.3}", "{angular: -0.3}", "armed[0].limits.angular"),
        ("topics:", "services:\n  - {service: /a, provider: client, limits: {linear: 1}}\ntopics:",
         "services[0].limits"),
    ],
)  # fmt: skip
def test_only_velocities_have_limits(old: str, new: str, location: str) -> None:
    assert [each.location for each in problems(FILE.replace(old, new))] == [location]


def test_check_shows_the_smallest_with_their_lines(path: Path) -> None:
    shown = {line.split()[1]: line for line in summary(load_file(path).session, demand_places(path))}
    assert SessionCheckText.LIMITED(limits=LIMITS, lines="robot.yaml:8") in shown["/cmd_vel"]
    both = "robot.yaml:6, robot.yaml:9"
    assert SessionCheckText.LIMITED(limits=VelocityLimits(0.2, 0.3), lines=both) in shown["/turn"]
    (pattern,) = [line for line in summary(load_file(path).session) if "/b/**" in line]
    assert SessionCheckText.LIMITED_PATTERN(limits=VelocityLimits(2.0)) in pattern


def test_check_shows_limits_on_server_without_routes(tmp_path: Path) -> None:
    """No entry has the name there; its clients' files do."""
    path = tmp_path / "pc.yaml"
    path.write_text(
        "name: pc\nrole: server\nserver_ip: 10.0.0.1\nserver_port: 5\nuse_encryption: false\n"
        "clients: [{name: r}]\narmed:\n"
        "  - {name: /cmd_vel, type: Twist, limits: {linear: 0.3}}\n"
        "  - {name: /helm, on_end: none}\n"
        "  - {name: /dock, kind: action, on_end: cancel}\n"
    )
    shown = "\n".join(summary(load_file(path).session, demand_places(path)))
    assert f"/cmd_vel, {SessionCheckText.LIMITED_PATTERN(limits=VelocityLimits(0.3))} (pc.yaml:8)" in shown
    assert f"/helm{SessionCheckText.ENDS_WITH(message='none', line='pc.yaml:9')}" in shown
    assert f"/dock{SessionCheckText.CANCELS(line='pc.yaml:10')}" in shown


def test_they_belong_to_the_name_and_its_type(path: Path) -> None:
    demands = Demands(sources_of(load_file(path).session))

    def found(name: str, type_name: str) -> VelocityLimits | None:
        demand = demands.of("topic", name, type_name)
        return None if demand is None else demand.limits

    assert found("/b/c", "geometry_msgs/msg/TwistStamped") == VelocityLimits(2.0)
    assert found("/b/c", "geometry_msgs/msg/Twist") is None
    service = demands.of("service", "/turn")
    assert service is not None
    assert service.limits is None


def test_armed_line_of_entry_has_its_limits() -> None:
    limited = Topic("/cmd", "receive", arm=True, limits=LIMITS)
    wider = Topic("/cmd", "transmit", arm=True, limits=VelocityLimits(0.6, 0.9))
    lines = tuple(sources_of(Session(name="r", role="client", server_ip="::1", topics=(limited, wider))))
    assert as_armed(lines[0]) == ArmedName("/cmd", "topic", limits=LIMITS)
    assert most_careful(lines).limits == VelocityLimits(0.5, 0.9)


@pytest.mark.parametrize("text", ["{linear: 0.5, angular: 1}", "{linear: .5}"])
def test_a_form_takes_them(text: str) -> None:
    topic = topic_of({"topic": "/cmd_vel", "direction": "receive", "limits": text})
    assert topic.limits is not None
    assert topic.limits.linear == 0.5
    assert topic_of(values_of(topic)) == topic
    assert problems_of(topic, SESSION, None) == {}


@pytest.mark.parametrize("text", ["0.5", "{linear: fast}", "{speed: 1}", "{linear: 0}", "{", "{linear: 1", "{}"])
def test_a_form_names_mistakes(text: str) -> None:
    topic = topic_of({"topic": "/cmd_vel", "direction": "receive", "limits": text})
    assert problems_of(topic, SESSION, None).keys() == {"limits"}


SESSION = Session(name="r", role="client", server_ip="10.0.0.1", server_port=5, use_encryption=False)
