"""Rights of the other side of a link: refusals on both sides, and changes by a reload."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support import constants
from tests.support.bridge import carries, find, happened, heard, linked, now, protocol_of, reloaded, route, stage
from tests.support.domain import text
from tests.support.frames import write_frame
from tests.support.rogue import Rogue
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.keys import read_key
from rsb_bridge.config.rights import DeniedText, Place
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Grant, Topic
from rsb_bridge.wire.messages import Report

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.model.session import Direction
    from rsb_bridge.wire.records import ReceivedCounts

CMD_VEL = Topic("/cmd_vel", "receive", type="std_msgs/msg/String")


def test_server_publishes_only_what_robots_file_lists(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Both sides say what would allow more; the client's operator may list it while the bridge runs."""
    listener, out = robot.listener("/cmd_vel"), pc.publisher("/cmd_vel")
    server, client = bridge.both()
    server.add_topic(CMD_VEL).result(60)
    eventually(lambda: route(server, "/cmd_vel").cause == "refused")
    assert says(route(server, "/cmd_vel").reason, Place.ON_CLIENT, client="robot1")
    assert happened(client, EventCode.ROUTE_REFUSED, DeniedText.NOT_ALLOWED, owner="robot1", use="/cmd_vel")
    assert find(client, "/cmd_vel") is None

    client.add_topic(CMD_VEL).result(60)
    carries([out], client, ["/cmd_vel"])
    out.publish(text("forward"))
    assert heard(listener, 1) == [text("forward")]


def test_server_reads_robot_unless_its_file_says_no(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    robot.publisher("/scan")
    robot.publisher("/secret")
    server, client = bridge.server(), bridge.client(deny=(Grant("/secret", may="read"),))
    eventually(lambda: linked(server))
    for name in ("/scan", "/secret"):
        server.add_topic(Topic(name, "transmit")).result(60)
    eventually(lambda: find(client, "/scan"))
    eventually(lambda: says(route(server, "/secret").reason, DeniedText.DENIED, owner="robot1", use="/secret"))
    assert find(client, "/secret") is None
    eventually(lambda: "/scan" in {each.topic for each in server.topics("robot1").result(60)})


def test_messages_cross_after_a_refused_proposal(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Both sides count it in the chain from which the keys of routes come."""
    robot.publisher("/secret")
    out, listener = robot.publisher("/scan"), pc.listener("/scan")
    server = bridge.server()
    bridge.client(deny=(Grant("/secret", may="read"),))
    eventually(lambda: linked(server))
    server.add_topic(Topic("/secret", "transmit")).result(60)
    eventually(lambda: route(server, "/secret").cause == "refused")
    server.add_topic(Topic("/scan", "transmit")).result(60)
    carries([out], server, ["/scan"])
    out.publish(text("seen"))
    assert heard(listener, 1) == [text("seen")]


def test_what_a_file_lists_the_server_may_edit(bridge: Bridge, pc: Domain) -> None:
    """Also after it has removed it; not once the client's operator has."""
    pc.publisher("/cmd_vel")
    server, client = bridge.both(CMD_VEL)
    eventually(lambda: find(server, "/cmd_vel"))
    changed = msgspec.structs.replace(route(server, "/cmd_vel").spec, protocol="udp")
    server.edit_topic(route(server, "/cmd_vel").key, changed).result(60)
    eventually(lambda: find(client, "/cmd_vel") and route(client, "/cmd_vel").transport == "udp")

    client.remove_topic(route(client, "/cmd_vel").key).result(60)
    eventually(lambda: find(server, "/cmd_vel") is None)
    server.add_topic(CMD_VEL).result(60)
    eventually(lambda: route(server, "/cmd_vel").cause == "refused")


def test_reload_ends_what_is_not_allowed_any_more(bridge: Bridge, pc: Domain, tmp_path: Path) -> None:
    """On a client as on a server; what is allowed again comes back."""
    pc.publisher("/cmd_vel")
    server, client = bridge.server(), bridge.client(allow=(Grant("/cmd_vel", may="publish"),))
    file = tmp_path / "robot1.yaml"
    eventually(lambda: linked(server))
    server.add_topic(CMD_VEL).result(60)
    eventually(lambda: find(client, "/cmd_vel"))

    changed = reloaded(client, file, deny=("/cmd*",)).changed
    assert len(changed) == 1
    assert "/cmd_vel may not cross any more" in changed[0]
    assert find(client, "/cmd_vel") is None
    assert happened(client, EventCode.ROUTE_REFUSED, DeniedText.DENIED, owner="robot1", use="/cmd_vel")
    eventually(lambda: says(route(server, "/cmd_vel").reason, DeniedText.DENIED, owner="robot1", use="/cmd_vel"))

    reloaded(client, file, deny=())
    eventually(lambda: find(client, "/cmd_vel"))


def test_file_that_no_longer_lists_topic_ends_servers(bridge: Bridge, pc: Domain, tmp_path: Path) -> None:
    pc.publisher("/cmd_vel")
    server, client = bridge.both(CMD_VEL)
    file = tmp_path / "robot1.yaml"
    assert reloaded(client, file).changed == ()
    eventually(lambda: find(server, "/cmd_vel"))
    changed = msgspec.structs.replace(route(server, "/cmd_vel").spec, protocol="udp")
    server.edit_topic(route(server, "/cmd_vel").key, changed).result(60)
    eventually(lambda: find(client, "/cmd_vel") and route(client, "/cmd_vel").transport == "udp")
    reloaded(client, file, topics=())
    assert find(client, "/cmd_vel") is None
    eventually(lambda: find(server, "/cmd_vel") is None)
    server.add_topic(CMD_VEL).result(60)
    eventually(lambda: route(server, "/cmd_vel").cause == "refused")


def test_a_client_is_held_to_direction_and_transport(bridge: Bridge) -> None:
    grants = (Grant("/out*", may="publish", protocol="udp"), Grant("/in*", may="read"))
    server = bridge.server(clients=(Client("robot1", allow=grants),))
    ways: dict[str, Direction] = {
        "/out_udp": "transmit",
        "/out_tcp": "transmit",
        "/in_udp": "receive",
        "/in_tcp": "receive",
    }
    wrong: dict[str, Direction] = {"/out_back": "receive", "/in_forth": "transmit"}
    client = bridge.client(*(Topic(name, way, protocol=protocol_of(name)) for name, way in (ways | wrong).items()))
    for name in ("/out_udp", "/in_udp", "/in_tcp"):
        eventually(lambda name=name: stage(client, name, "peer accepted"))
    for name in ("/out_tcp", "/out_back", "/in_forth"):
        eventually(lambda name=name: route(client, name).cause == "refused")
        assert find(server, name) is None


def test_server_has_client_keep_so_many_topics(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """The client's own topics are not counted, and kept ones are proposed again after a reconnect."""
    constants.ROUTES_PROPOSED_BY_SERVER.set(monkeypatch, 2)
    topics = tuple(Topic(f"/t{number}", "transmit") for number in range(3))
    server = bridge.server(clients=(Client("robot1", topics=topics),))
    client = bridge.client(Topic("/own", "transmit"), Topic("/own2", "transmit"))
    eventually(lambda: Denied.TOO_MANY_OF_SERVER(client="robot1", count=2) in route(server, "/t2").reason)
    assert {each.topic for each in now(client).routes} == {"/own", "/own2", "/t0", "/t1"}
    assert happened(client, EventCode.ROUTE_REFUSED, Denied.TOO_MANY_OF_SERVER, count=2)
    client.restart().result(60)
    eventually(lambda: linked(server))
    eventually(lambda: all(stage(server, topic.topic, "peer accepted") for topic in topics[:2]))


@pytest.mark.parametrize("direction", ["transmit", "receive"])
def test_side_lets_no_more_cross_than_it_allows(
    direction: Direction, bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path
) -> None:
    """The sender keeps to the limit, and both screens show it; a reload changes it on the open route."""
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    out, listener = near.publisher("/chat"), far.listener("/chat")
    slow = Client("robot1", key_file="robot1.key", allow=(Grant("/chat", max_rate=0.01),))
    server, client = bridge.server(clients=(slow,)), bridge.client(Topic("/chat", direction))
    carries([out], server if direction == "transmit" else client, ["/chat"])
    eventually(lambda: route(client, "/chat").max_rate == route(server, "/chat").max_rate == 0.01)
    assert route(client, "/chat").spec.max_rate is None, "its operator's entry stays"
    for number in range(5):
        out.publish(text(str(number)))
    eventually(lambda: route(client, "/chat").ledger.throttled == 4)
    assert heard(listener, 1) == [text("0")]

    reloaded(server, tmp_path / "pc.yaml", clients=(Client("robot1", key_file="robot1.key"),))
    eventually(lambda: route(client, "/chat").max_rate is route(server, "/chat").max_rate is None)
    out.publish(text("free"))
    assert heard(listener, 2) == [text("0"), text("free")]


def test_peer_that_sends_too_fast_is_throttled(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 600.0)  # the rogue says nothing while it waits
    slow = Client("robot1", allow=(Grant("/chat", may="publish", max_rate=0.01),))
    server = bridge.server(clients=(slow,))
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        number = rogue.route("/chat", "tcp", Qos())
        stream, writer = rogue.stream(number)
        for _ in range(50):
            stream.sendall(write_frame(writer, b"\0\1\0\0", 0, 0))

        def counted() -> ReceivedCounts:
            while not (report := rogue.wait_for(Report)).received_counts:
                pass
            return report.received_counts[0]

        eventually(lambda: counted().dropped.get("throttled", 0) >= 48)
    assert happened(server, EventCode.ROUTE_TOO_FAST)
