"""Patterns of topics between two ROS domains: in either graph, within what either side allows, and without loops."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from std_msgs.msg import Int32
from std_srvs.srv import SetBool
from tests.support.bridge import carries, find, happened, heard, link, now
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import load, save
from rsb_bridge.link.pattern_hints import MeaningText
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Grant, Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import PatternSnapshot

CAMERA = Topic("/camera/**", "transmit", excepts=("/camera/**/compressed", "/camera/debug/*"))


def topics(engine: Engine) -> set[str]:
    return {route.topic for route in now(engine).routes}


def pattern(engine: Engine, name: str) -> PatternSnapshot:
    return next(each for each in link(engine).patterns if each.spec.topic == name)


def test_what_client_publishes_is_bridged_as_it_comes(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    server, client = bridge.both(CAMERA, Topic("/*", "transmit", remote_topic="/robot1/*"))
    assert pattern(client, "/camera/**").state is State.WAITING
    out = robot.publisher("/camera/left/image")
    for left_out in ("/camera/left/compressed", "/camera/debug/x", "/camera/_hidden/x", "/shutdown"):
        robot.publisher(left_out)
    robot.publisher("/scan")
    listener = pc.listener("/camera/left/image")
    eventually(lambda: topics(client) == {"/camera/left/image", "/scan"})
    eventually(lambda: topics(server) == {"/camera/left/image", "/robot1/scan"})
    carries([out], server, ["/camera/left/image"])
    out.publish(text("a picture"))
    assert heard(listener, 1) == [text("a picture")]
    assert {route.topic: route.pattern for route in now(client).routes} == {
        "/camera/left/image": "/camera/**",
        "/scan": "/*",
    }
    assert (pattern(client, "/camera/**").state, pattern(client, "/camera/**").routes) == (State.OK, 1)
    assert client.session.topics == (CAMERA, Topic("/*", "transmit", remote_topic="/robot1/*"))


@pytest.mark.parametrize("lister", ["client", "server"])
def test_pattern_that_matches_nothing_names_what_it_may_mean(
    lister: str, bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    """In both graphs: a similar name, one in a namespace, or one that matches on the side that it does not follow."""
    listed = (
        Topic("/cam/*", "transmit"),
        Topic("/arm/*", "transmit"),
        Topic("/scan/*", "receive"),
        Topic("/cmd/*", "receive"),
        Topic("/imu/*", "transmit"),
        Topic("/dock/*", "receive", kind="service"),
        Topic("/maps/*", "receive", kind="service"),
    )
    for name in ("/camera/image", "/scan/front", "/robot/imu/data"):
        robot.publisher(name)
    for name in ("/arm/state", "/cmds/vel", "/imu_/raw"):
        pc.publisher(name)
    robot.serve("/docks/go", SetBool)
    pc.serve("/maps/save", SetBool)
    client = Client("robot1", key_file=bridge.key_file, topics=listed if lister == "server" else ())
    server = bridge.server(clients=(client,))
    own = listed if lister == "client" else ()
    engine = {"server": server, "client": bridge.client(*own, allow=(Grant("/**"), Grant(services="/**")))}[lister]
    here, there = ("here", "on the other side") if lister == "client" else ("on the other side", "here")
    expected = {
        "/cam/*": MeaningText.NEAR(name="/camera/image"),
        "/arm/*": MeaningText.OTHER_WAY(name="/arm/state", offered="published", where=there, direction="receive"),
        "/scan/*": MeaningText.OTHER_WAY(name="/scan/front", offered="published", where=here, direction="transmit"),
        "/cmd/*": MeaningText.NEAR(name="/cmds/vel"),
        "/imu/*": MeaningText.NEAR(name="/robot/imu/data"),
        "/dock/*": MeaningText.NEAR(name="/docks/go"),
        "/maps/*": MeaningText.OTHER_WAY(name="/maps/save", offered="provided", where=there, direction="transmit"),
    }

    def hints() -> dict[str, str]:
        reasons = {each.spec.topic: each.reason for each in link(engine).patterns}
        return {name: "".join(reason.partition(";")[1:]) for name, reason in reasons.items()}

    eventually(lambda: hints() == expected)
    assert all(each.state is State.WAITING for each in link(engine).patterns)


def test_what_server_publishes_is_followed_by_client(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """The server tells what matches as it comes, under its own names; only what it lets the client read."""
    server = bridge.server(clients=(Client("robot1", use_name=True, key_file=bridge.key_file, deny=("/secret",)),))
    client = bridge.client(Topic("/**", "receive"))
    eventually(lambda: link(client).patterns[0].state is State.WAITING and link(client).state is State.OK)
    out = pc.publisher("/robot1/cmd/vel")
    pc.publisher("/robot1/secret")
    pc.publisher("/robot2/cmd/vel")
    listener = robot.listener("/cmd/vel")
    carries([out], client, ["/cmd/vel"])
    out.publish(text("go"))
    assert heard(listener, 1) == [text("go")]
    assert topics(client) == {"/cmd/vel"}
    assert topics(server) == {"/robot1/cmd/vel"}


def test_a_server_proposes_what_matches(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Both kinds of graph, from the other side; the client's own rights hold."""
    robot.publisher("/camera/image")
    robot.publisher("/camera/secret")
    pc.publisher("/cmd/vel")
    listed = (Topic("/camera/*", "transmit"), Topic("/cmd/*", "receive"))
    server = bridge.server(clients=(Client("robot1", key_file=bridge.key_file, topics=listed),))
    client = bridge.client(allow=(Grant("/camera/*"), Grant("/cmd/*")), deny=("/camera/secret",))
    eventually(lambda: topics(client) == {"/camera/image", "/cmd/vel"})
    assert topics(server) == {"/camera/image", "/cmd/vel"}
    assert {route.pattern for route in now(client).routes} == {""}, "they are the other side's"


def test_nothing_is_taken_back(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Everything in both directions: topics from the other side are not sent back."""
    server, client = bridge.both(Topic("/**", "transmit"), Topic("/**", "receive"))
    robot.publisher("/scan")
    pc.publisher("/cmd_vel")
    eventually(lambda: topics(client) >= {"/scan", "/cmd_vel"} and topics(server) >= {"/scan", "/cmd_vel"})
    pc.publisher("/late")  # by now both sides have seen what the bridges publish
    eventually(lambda: find(client, "/late"))
    directions = {route.topic: route.spec.direction for route in now(client).routes}
    assert len(now(client).routes) == 3
    assert directions == {"/scan": "transmit", "/cmd_vel": "receive", "/late": "receive"}


def test_calls_are_followed_where_somebody_provides_them(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    robot.serve("/nav/pause", SetBool)
    pc.serve("/nav/there", SetBool)
    server, client = bridge.both(
        Topic("/nav/*", "receive", kind="service"), Topic("/nav/*", "transmit", kind="service", excepts=("/nav/x",))
    )
    eventually(lambda: topics(server) == {"/nav/pause", "/nav/there"})
    assert {route.topic: route.spec.provider for route in now(client).routes} == {
        "/nav/pause": "client",
        "/nav/there": "server",
    }


def test_type_limits_pattern_first_match_wins(bridge: Bridge, robot: Domain) -> None:
    listed = Topic("/a/listed", "transmit", max_rate=1.0)
    _, client = bridge.both(
        Topic("/a/*", "transmit", type="std_msgs/msg/Int32", max_rate=2.0), Topic("/**", "transmit"), listed
    )
    robot.publisher("/a/number", Int32)
    robot.publisher("/a/text")
    robot.publisher("/a/listed", Int32)
    eventually(lambda: topics(client) == {"/a/number", "/a/text", "/a/listed"})
    rates = {route.topic: (route.pattern, route.spec.max_rate) for route in now(client).routes}
    assert rates == {"/a/number": ("/a/*", 2.0), "/a/text": ("/**", None), "/a/listed": ("", 1.0)}


def test_operators_of_either_side_remove_edit_and_save(bridge: Bridge, robot: Domain, tmp_path: Path) -> None:
    """Removed topics stay removed, an edited one becomes an entry of its own, and the file keeps the patterns."""
    server, client = bridge.both()
    for name in "abcd":
        robot.publisher(f"/x/{name}")
    key = client.add_topic(Topic("/x/*", "transmit")).result(60)
    eventually(lambda: topics(server) == {"/x/a", "/x/b", "/x/c", "/x/d"})
    routes = {route.topic: route.key for route in now(client).routes}
    client.remove_topic(routes["/x/a"]).result(60)
    client.edit_topic(routes["/x/b"], Topic("/x/b", "transmit", max_rate=5.0)).result(60)
    there = {route.topic: route.key for route in now(server).routes}
    server.remove_topic(there["/x/c"]).result(60)
    eventually(lambda: pattern(client, "/x/*").spec.excepts == ("/x/a", "/x/c"))
    robot.publisher("/x/e")
    eventually(lambda: topics(server) == {"/x/b", "/x/d", "/x/e"})
    assert set(client.session.topics) == {
        Topic("/x/b", "transmit", max_rate=5.0),
        Topic("/x/*", "transmit", excepts=("/x/a", "/x/c")),
    }
    path = tmp_path / "session.yaml"
    save(client.session, path)
    assert load(path) == client.session
    client.edit_topic(key, Topic("/x/*", "transmit", excepts=("/x/d",))).result(60)
    eventually(lambda: topics(server) == {"/x/a", "/x/b", "/x/c", "/x/e"})
    client.remove_topic(key).result(60)
    eventually(lambda: topics(server) == {"/x/b"})
    assert happened(client, EventCode.OPERATOR_REMOVED, "/x/*")


def test_a_reload_changes_patterns_and_leaves_what_stays(bridge: Bridge, robot: Domain, tmp_path: Path) -> None:
    for name in ("/x/a", "/y/a"):
        robot.publisher(name)
    server, client = bridge.both(Topic("/x/*", "transmit"))
    eventually(lambda: topics(server) == {"/x/a"})
    path = tmp_path / "session.yaml"
    changed = (Topic("/y/*", "transmit"), Topic("/x/*", "transmit", max_rate=3.0))
    save(msgspec.structs.replace(client.session, topics=changed), path)
    client.use_file(path)
    assert len(client.reload().result(60).changed) == 3
    eventually(lambda: topics(server) == {"/x/a", "/y/a"})
    assert {route.topic: route.spec.max_rate for route in now(client).routes} == {"/x/a": 3.0, "/y/a": None}
    assert client.session.topics == changed
    assert client.reload().result(60).changed == ()
