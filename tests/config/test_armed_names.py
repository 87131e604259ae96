"""A session's `armed`: read, checked, located and written."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from tests.config.mistakes import problems

from rsb_bridge.config.session_file import demand_places, load_file, save
from rsb_bridge.config.topic_rules import topic_problems
from rsb_bridge.model.session import ArmedName, Session, Topic
from rsb_console.command.check import SessionCheckText, hints, summary

FILE = """\
name: pc
role: server
server_ip: 10.0.0.1
server_port: 5
key_file: pc.key
# what moves
armed: [/cmd_vel, "/arm/**"]
clients:
  - name: robot1
    topics:
      - topic: /cmd_vel
        direction: receive
        arm: true
      - {topic: "/go*", direction: receive, arm: true}
      - {topic: /scan, direction: transmit}
"""


def test_the_lines_that_demand_are_found(tmp_path: Path) -> None:
    path = tmp_path / "pc.yaml"
    path.write_text(FILE)
    assert sorted(demand_places(path).values()) == ["pc.yaml:13", "pc.yaml:14", "pc.yaml:7", "pc.yaml:7"]
    assert demand_places(tmp_path / "none.yaml") == {}


@pytest.mark.parametrize(
    "armed",
    [
        ("/cmd_vel",),
        ("/cmd_vel", "/arm/**", ArmedName("/stop", deadman=5.0)),
        ("/cmd_vel", ArmedName("/a*", "topic", "geometry_msgs/msg/Twist")),
        (ArmedName("/dock", kind="action", on_end="cancel"), ArmedName("/any/**", on_end="cancel")),
        (
            ArmedName("/r/go", "topic", client="r", topic="/go"),
            ArmedName("/go*", client="r", excepts=("/go_on", "/gone*")),
        ),
        (ArmedName("/cmd_vel", on_end="none"), ArmedName("/helm", on_end={"linear": {"x": 0.1}})),
        (),
    ],
)
def test_what_is_saved_is_what_is_read(armed: tuple[str | ArmedName, ...], tmp_path: Path) -> None:
    path = tmp_path / "pc.yaml"
    path.write_text(FILE)
    opened = load_file(path)
    save(msgspec.structs.replace(opened.session, armed=armed), path, opened)
    again = load_file(path)
    assert again.session.armed == armed
    assert "# what moves" in again.text or not armed


@pytest.mark.parametrize(
    ("armed", "location"),
    [
        ("[cmd_vel]", "armed[0]"),
        ("[/cmd_vel, /cmd_vel]", "armed[1]"),
        ("[/cmd_vel, {name: /cmd_vel, deadman: 5}]", "armed[1]"),
        ('[{name: "/c*", except: [/c_a]}, {name: "/c*", except: [/c_b]}]', "armed[1]"),
        ("[{name: /cmd_vel, deadman: 0.1}]", "armed[0].deadman"),
        ('[{name: "/a/***"}]', "armed[0].name"),
        ("[{name: /a, kind: node}]", "armed[0].kind"),
        ("[{name: /a, except: [/b]}]", "armed[0].except"),
        ('[{name: "/a*", except: [b]}]', "armed[0].except[0]"),
        ("[{name: /a, excepts: [/b]}]", "armed[0].excepts"),
        ('[{name: "/a*", topic: /b}]', "armed[0].topic"),
        ("[{name: /a, topic: b}]", "armed[0].topic"),
        ("/cmd_vel", "armed"),
        ("[{name: /cmd_vel, on_end: stop}]", "armed[0].on_end"),
        ("[{name: /cmd_vel, kind: topic, on_end: cancel}]", "armed[0].on_end"),
        ("[{name: /dock, kind: action, on_end: zero}]", "armed[0].on_end"),
        ("[{name: /dock, kind: action, on_end: {x: 1}}]", "armed[0].on_end"),
        ("[{name: /dock, kind: service, on_end: cancel}]", "armed[0].on_end"),
        ('[{name: /cmd_vel, on_end: "{x: 1"}]', "armed[0].on_end"),
        ("[{name: /cmd_vel, on_end: {x: %s}}]" % ("1" * 200), "armed[0].on_end"),
    ],
)
def test_mistakes_are_located(armed: str, location: str) -> None:
    (problem,) = problems(FILE.replace('[/cmd_vel, "/arm/**"]', armed))
    assert (problem.location, problem.line) == (location, 7)


def test_check_names_the_line_that_demands(tmp_path: Path) -> None:
    path = tmp_path / "pc.yaml"
    path.write_text(FILE.replace("{topic: /scan, direction: transmit}", "{topic: /gone, direction: transmit}"))
    lines = list(summary(load_file(path).session, demand_places(path)))
    (shadowed,) = [line for line in lines if "/gone" in line]
    assert "pc.yaml:14" in shadowed
    (listed,) = [line for line in lines if "/arm/**" in line]
    assert "pc.yaml:7" in listed


def test_rest_at_end_of_arming_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "name: r\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 5\nuse_encryption: false\n"
        "armed: [{name: /helm, on_end: {x: 1}}]\ntopics:\n"
        "  - {topic: /helm, direction: receive}\n"
        "  - {topic: /cmd_vel, direction: receive, type: Twist, arm: true}\n"
        "  - {topic: /light, direction: receive, type: Bool, arm: true}\n"
        "  - {topic: /go, direction: receive, arm: true, on_end: none}\n"
        "  - {topic: /far, direction: transmit, type: Twist, arm: true, on_end: {linear: {x: 1}}}\n"
        "  - {topic: /far_light, direction: transmit, type: Bool, arm: true, on_end: zero}\n"
        "actions:\n"
        "  - {action: /dock, provider: client, arm: true, on_end: cancel}\n"
        "  - {action: /spin, provider: client, arm: true}\n"
    )
    session = load_file(path).session
    described = summary(session, demand_places(path))
    shown = {line.split()[1]: line for line in described if line.startswith(("  receive", "  transmit"))}
    assert '{"x": 1}' in shown["/helm"]
    assert "robot.yaml:6" in shown["/helm"].rpartition('{"x": 1}')[2]
    assert SessionCheckText.ENDS_WITH_ZERO() in shown["/cmd_vel"]
    assert SessionCheckText.ENDS_WITH_NOTHING() in shown["/light"]
    assert SessionCheckText.ENDS_WITH(message="none", line="robot.yaml:11") in shown["/go"]
    assert SessionCheckText.ENDS_AS_THERE_OR_ZERO() in shown["/far"]
    assert SessionCheckText.ENDS_AS_THERE() in shown["/far_light"]
    actions = [line for line in summary(session, demand_places(path)) if "/dock" in line or "/spin" in line]
    assert any(SessionCheckText.CANCELS(line="robot.yaml:15") in line for line in actions)
    assert any(SessionCheckText.GOALS_GO_ON() in line for line in actions)
    (alone,) = [line for line in hints(session) if "/cmd_vel" in line]
    assert alone == SessionCheckText.NO_OTHER_GUARD(names="/cmd_vel")


@pytest.mark.parametrize("topic", [Topic("/a", "receive", on_end="zero"), Topic("/a", "receive", kind="service")])
def test_only_topic_to_be_armed_has_end(topic: Topic) -> None:
    topic = msgspec.structs.replace(topic, on_end="zero")
    assert "on_end" in {problem.location for problem in topic_problems(topic, None, None)}


def test_line_that_only_limits_age_demands_no_arming() -> None:
    entries = (
        Topic("/scan", "transmit", max_age=0.0),
        Topic("/odom", "transmit", max_age=2.0),
        Topic("/reset", "transmit", kind="service", max_age=1.5),
    )
    session = Session(name="r", role="client", server_ip="::1", server_port=1, topics=entries)
    assert not any("armed" in line for line in summary(session))


def test_limit_from_other_line_is_shown() -> None:
    entries = Topic("/cmd*", "receive", arm=True, max_age=0.5), Topic("/cmd_vel", "receive"), Topic("/arm", "receive")
    session = Session(
        name="r", role="client", server_ip="::1", server_port=1, topics=entries, armed=(ArmedName("/arm", deadman=0.0),)
    )
    shown = {line.split()[1]: line for line in summary(session) if line.startswith("  receive")}
    assert "0.5 s" in shown["/cmd_vel"]
    assert "1 s" in shown["/arm"]
