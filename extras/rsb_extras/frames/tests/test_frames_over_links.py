"""Robots' frames and stamps at a control PC, over sockets, with stock nodes at both ends."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as Plan
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header
from tests.ros.conftest import open_node
from tests.support.bridge import happened, linked, reloaded, route
from tests.support.domain import LATCHED
from tests.support.inside import inside
from tests.support.spun import Spun
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_console.notation.route_fact import facts_of
from rsb_extras.demo.robot_frames import Frame, FrameBroadcaster, serialized
from rsb_extras.frames.frame_lines import FACT, FrameLine
from rsb_extras.frames.link_frames import FramesCause, FramesCode, FramesText, StampShift

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.ros.node import RosNode

__all__ = ["open_node"]  # a fixture
TFMESSAGE = "tf2_msgs/msg/TFMessage"
TF, STATIC = Topic("/tf", "transmit"), Topic("/tf_static", "transmit")
MAP = Topic("/map_frame", "transmit")
PLAN = Topic("/plan", "transmit")


class Robot:
    """A stock node in a domain that publishes frames, and describes their type."""

    def __init__(self, domain_id: int, name: str) -> None:
        self._node = Spun(domain_id, f"{name}_describes")
        self._frames = FrameBroadcaster(self._node.node, [Frame("base_link", "laser"), Frame("/base_link", "camera")])

    def moves(self) -> bool:
        self._frames.publish(lambda: [Frame("odom", "base_link", 1.5)])
        return True

    def close(self) -> None:
        self._frames.close()
        self._node.close()


class Tree:
    """The parents of all frames in a domain, as its nodes hear them from now on."""

    def __init__(self, node: RosNode, text: str, *topics: str) -> None:
        self.parents: dict[str, str] = {}
        type_hash = hash_of_text(text)
        self._description = read_description(text, type_hash)
        for topic in topics:
            qos = Qos(durability="transient_local" if topic == "/tf_static" else "volatile")
            node.subscribe(TopicSpec(topic, TFMESSAGE, type_hash, qos), self._take, topic)

    def _take(self, batch: Any) -> None:
        for sample in batch:
            transforms: Any = decode(self._description, sample.payload).message["transforms"]
            for each in transforms.shown:
                self.parents[each["child_frame_id"]] = each["header"]["frame_id"]


@pytest.fixture
def robots(robot: Domain, third: Domain) -> Iterator[tuple[Robot, Robot]]:
    made = Robot(robot.id, "robot1"), Robot(third.id, "robot2")
    yield made
    for each in made:
        each.close()


def description(node: RosNode) -> str:
    """Return the description of the frames' type, of a robot in a node's domain."""
    there = eventually(lambda: node.publishers("/tf_static"), what="frames")[0]

    def ask() -> str | None:
        return node.ask_description("/robot_state_publisher", TFMESSAGE, there.type_hash, lambda: True)

    text = eventually(ask, what="a description")
    assert text is not None
    return text


def test_two_robots_have_one_tree(
    bridge: Bridge, third: Domain, robots: tuple[Robot, Robot], open_node: Callable[..., RosNode]
) -> None:
    """Nothing on the PC knows the type of their frames."""
    names = ("robot1", "robot2")
    keys = {"robot1": bridge.key_file, "robot2": bridge.make_key("robot2")}
    clients = tuple(Client(name, key_file=keys[name], features={"frame_prefix": f"{name}/"}) for name in names)
    pc = bridge.server(clients=clients)
    for name, domain in zip(names, (bridge.robot, third), strict=True):
        session = bridge.client_session(TF, STATIC, name=name, domain_id=domain.id, key_file=keys[name])
        bridge.start(session)
        eventually(lambda name=name: linked(pc, name), what="linked")
    text = description(open_node(bridge.robot.id, "near"))
    tree = Tree(open_node(bridge.pc.id, "rviz"), text, "/tf", "/tf_static")
    expected = {
        f"{name}/{child}": f"{name}/{parent}"
        for name in names
        for child, parent in (("base_link", "odom"), ("laser", "base_link"), ("camera", "base_link"))
    }
    eventually(lambda: all(each.moves() for each in robots) and tree.parents == expected, what="the tree")
    late = Tree(open_node(bridge.pc.id, "late"), text, "/tf_static")
    fixed = {child: parent for child, parent in expected.items() if not child.endswith("base_link")}
    eventually(lambda: late.parents == fixed, what="what is latched")


def test_prefix_changes_while_it_runs(bridge: Bridge, tmp_path: Path) -> None:
    """Late joiners of a latched topic hear no frame by its former name; others hear the next one by the new name."""
    latched = bridge.robot.publisher("/map_frame", Header, LATCHED)
    latched.publish(Header(frame_id="map"))
    plans = bridge.robot.publisher("/plan", Plan)
    pc, _ = bridge.both(MAP, PLAN)

    def frames() -> list[str]:
        listener = bridge.pc.listener("/map_frame", Header, LATCHED)
        eventually(lambda: listener.payloads, what="the latched message")
        found = [deserialize_message(each, Header).frame_id for each in listener.payloads]
        bridge.pc.clear()
        return found

    assert frames() == ["map"]
    assert path_of(pc, "/plan").transforms == ()
    reloaded(pc, tmp_path / "pc.yaml", features={"frame_prefix": "r1/"})
    eventually(lambda: frames() == ["r1/map"], what="the prefix")
    heard = bridge.pc.listener("/plan", Plan)
    message = Plan(header=Header(frame_id="map"), poses=[PoseStamped(header=Header(frame_id="/odom"))] * 3)

    def last() -> Plan:
        plans.publish(message)
        return deserialize_message(heard.payloads[-1], Plan) if heard.payloads else Plan()

    eventually(lambda: last().header.frame_id == "r1/map", what="a plan")
    assert [each.header.frame_id for each in last().poses] == ["r1/odom"] * 3
    opened = route(pc, "/plan").ledger
    reloaded(pc, tmp_path / "pc.yaml", features={})
    eventually(lambda: last().header.frame_id == "map", what="none")
    assert route(pc, "/plan").ledger.offered >= opened.offered, "its route stayed open"
    eventually(lambda: frames() == ["map"], what="none, latched")


def path_of(engine: Engine, topic: str) -> Any:
    (found,) = [each for link in inside(engine).role.links() for each in link.routes.values() if each.topic == topic]
    return found.half.path  # type: ignore[attr-defined]


def test_entry_has_its_own_prefix(bridge: Bridge) -> None:
    """Where both sides list a topic, the receiving side's keys count there."""
    for topic in ("/a", "/b", "/c"):
        bridge.robot.publisher(topic, Header, LATCHED).publish(Header(frame_id="map"))
    own = (
        Topic("/a", "transmit", features={"frame_prefix": "x/"}),
        Topic("/b", "transmit", features={"frame_prefix": ""}),
    )
    bridge.server(clients=(Client("robot1", key_file=bridge.key_file, topics=own, features={"frame_prefix": "y/"}),))
    bridge.client(*(Topic(each, "transmit") for each in ("/a", "/b", "/c")))
    listeners = [bridge.pc.listener(topic, Header, LATCHED) for topic in ("/a", "/b", "/c")]
    eventually(lambda: all(each.payloads for each in listeners), what="all three")
    found = [deserialize_message(each.payloads[-1], Header).frame_id for each in listeners]
    assert found == ["x/map", "map", "y/map"]


def test_a_client_prefixes_what_its_server_sends(bridge: Bridge) -> None:
    bridge.pc.publisher("/goal_frame", Header, LATCHED).publish(Header(frame_id="map"))
    bridge.server()
    bridge.client(Topic("/goal_frame", "receive"), features={"frame_prefix": "pc/"})
    heard = bridge.robot.listener("/goal_frame", Header, LATCHED)
    eventually(lambda: heard.payloads, what="the message")
    assert deserialize_message(heard.payloads[0], Header).frame_id == "pc/map"


# -- stamps


class Ahead(Clock):
    """A robot's clock that is an hour ahead."""

    def time_ns(self) -> int:
        return super().time_ns() + 3600 * 10**9


def stamps(bridge: Bridge, **features: Any) -> tuple[Engine, Callable[..., Header]]:
    """Return the PC, and what sends a robot's message, whose clock is an hour ahead, until one comes."""
    publisher = bridge.robot.publisher("/scan_header", Header)
    pc = bridge.server(features={"restamp": True, **features})
    bridge.start(bridge.client_session(Topic("/scan_header", "transmit")), clock=Ahead())
    heard = bridge.pc.listener("/scan_header", Header)

    def send(seconds: int) -> Header:
        sent = Header(frame_id=str(seconds))
        sent.stamp.sec = seconds

        def came() -> Header | None:
            publisher.publish(sent)
            found = deserialize_message(heard.payloads[-1], Header) if heard.payloads else Header()
            return found if found.frame_id == sent.frame_id else None

        found = eventually(came, what="a message")
        assert isinstance(found, Header)
        return found

    return pc, send


def test_stamps_are_on_this_machines_clock(bridge: Bridge) -> None:
    pc, send = stamps(bridge, restamp_within=10.0)
    here = int(time.time())
    assert abs(send(here + 3600).stamp.sec - here) <= 11
    assert happened(pc, FramesCode.RESTAMPS, "stamps are shifted by -3")
    rewritten = [("Rewritten", FrameLine.RESTAMPS())]
    eventually(lambda: [*facts_of(route(pc, "/scan_header"))] == rewritten, what="what info and the details say")
    none = send(0).stamp
    assert none.sec == none.nanosec == 0


def test_a_shifted_stamp_is_not_corrected_again_for_a_viewer(bridge: Bridge) -> None:
    pc, send = stamps(bridge, restamp_within=10.0)
    send(5000)
    shown = pc.peek(route(pc, "/scan_header").key, kept=False)
    send(5001)
    message = shown.result(30)
    assert message is not None
    assert message.clock_offset == 0.0


def test_an_unsure_clock_changes_no_stamp_and_is_shown(bridge: Bridge) -> None:
    pc, send = stamps(bridge, restamp_within=1e-9)
    assert send(5000).stamp.sec == 5000
    eventually(lambda: route(pc, "/scan_header").cause == FramesCause.CLOCK, what="a note")
    shown = route(pc, "/scan_header")
    assert shown.state is State.OK
    assert "not restamped" in shown.reason


# -- a type that nobody describes


def test_frames_without_a_description_wait_for_one(bridge: Bridge, open_node: Callable[..., RosNode]) -> None:
    node = open_node(bridge.robot.id, "nameless")
    helper = Robot(bridge.robot.id, "robot1")
    text = description(node)
    helper.close()
    eventually(lambda: not node.publishers("/tf_static"), what="nobody who describes it")
    pc, _ = bridge.both(STATIC, features={"frame_prefix": "r1/"})
    spec = TopicSpec("/tf_static", TFMESSAGE, hash_of_text(text), Qos(durability="transient_local", depth=1))
    node.advertise(spec, "robot").publish(serialized([Frame("arm", "gripper")], 0))
    eventually(lambda: route(pc, "/tf_static").cause == FramesCause.NOT_DESCRIBED, what="a fault")
    assert route(pc, "/tf_static").state is State.DOWN
    tree = Tree(open_node(bridge.pc.id, "rviz"), text, "/tf_static")
    helper = Robot(bridge.robot.id, "robot1")
    eventually(lambda: tree.parents.get("r1/gripper") == "r1/arm", what="the frames")
    assert not [each for each in tree.parents if not each.startswith("r1/")]
    helper.close()


def test_restamping_alone_keeps_nothing_back(bridge: Bridge, open_node: Callable[..., RosNode]) -> None:
    node = open_node(bridge.robot.id, "nameless")
    helper = Robot(bridge.robot.id, "robot1")
    text = description(node)
    helper.close()
    eventually(lambda: not node.publishers("/tf_static"), what="nobody who describes it")
    pc, _ = bridge.both(STATIC, features={"restamp": True})
    spec = TopicSpec("/tf_static", TFMESSAGE, hash_of_text(text), Qos(durability="transient_local", depth=1))
    node.advertise(spec, "robot").publish(serialized([Frame("arm", "gripper")], 0))
    tree = Tree(open_node(bridge.pc.id, "rviz"), text, "/tf_static")
    eventually(lambda: tree.parents.get("gripper") == "arm", what="the frames")
    eventually(lambda: route(pc, "/tf_static").cause == FramesCause.NOT_DESCRIBED, what="a note")
    assert route(pc, "/tf_static").state is State.OK


def test_a_shift_stays_until_the_clocks_contradict_it() -> None:
    stamps = StampShift()
    stamps.look(None, None, 0.1)
    assert (stamps.shift, stamps.problem) == (None, FramesText.UNKNOWN())
    stamps.look(2.0, 0.05, 0.1)
    assert (stamps.shift, stamps.problem) == (-2_000_000_000, "")
    stamps.look(2.04, 0.05, 0.1)
    assert stamps.shift == -2_000_000_000
    stamps.look(2.04, 0.03, 0.1)
    assert stamps.shift == -2_040_000_000
    stamps.look(2.04, 0.19, 0.1)  # the error of a path that is as long as the bound goes up and down
    assert (stamps.shift, stamps.problem) == (-2_040_000_000, "")
    stamps.look(2.04, 0.21, 0.1)
    assert stamps.shift is None
    assert has_text(stamps.problem, FramesText.UNSURE, error=0.21, within=0.1)
    stamps.look(2.04, 0.11, 0.1)
    assert stamps.shift is None
    stamps.look(2.0, 0.1, 0.1)
    assert stamps.shift == -2_000_000_000


def test_prefix_and_stamps_are_one_line() -> None:
    shown: Any = SimpleNamespace(features={"rewritten": {"prefix": "robot1/", "restamps": True}})
    assert FACT.line(shown) == f"{FrameLine.PREFIX(prefix='robot1/')}; {FrameLine.RESTAMPS()}"
    assert FACT.line(SimpleNamespace(features={})) == ""  # type: ignore[arg-type]  # a snapshot without features
