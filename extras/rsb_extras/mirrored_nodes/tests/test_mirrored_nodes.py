"""The robot's nodes stand in the PC's domain, as ROS's own tools look: real nodes, in a process of their own."""

from __future__ import annotations

import threading
from contextlib import closing
from typing import TYPE_CHECKING, Any

import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger
from tests.support.bridge import happened, is_accepted, link, linked, reloaded, route
from tests.support.domain import LATCHED
from tests.support.inside import inside
from tests.support.places import Place
from tests.support.spun import Spun
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_extras.mirrored_nodes import MIRRORED, GraphKeys
from rsb_extras.mirrored_nodes.link_mirrors import LinkMirrors, MirrorCode
from rsb_extras.mirrored_nodes.mirror_table import MirrorTable, NotMirrored
from rsb_extras.mirrored_nodes.tests.far_program import CAMERA, LIDAR, FarProgram
from rsb_extras.nodes.link_nodes import LinkNodes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.feature_api import Link

ON: dict[str, Any] = {"features": {"graph": GraphKeys(nodes=True)}}
STRING = "std_msgs/msg/String"
TOPICS = (
    Topic("/scan", "transmit"),
    Topic("/plan", "transmit"),
    Topic("/speed", "receive", type=STRING),
    Topic("/front/reset", "receive", kind="service"),
)


def names(domain: Domain) -> list[str]:
    found = domain.node.get_node_names_and_namespaces()
    return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in found)


def info(domain: Domain, node: str) -> tuple[set[str], set[str], set[str]]:
    """What `ros2 node info` shows: the topics that a node publishes and hears, and its services."""
    if node not in names(domain):
        return set(), set(), set()
    namespace, _, name = node.rpartition("/")
    asked = name, namespace or "/"
    of = domain.node
    found = (
        of.get_publisher_names_and_types_by_node(*asked),
        of.get_subscriber_names_and_types_by_node(*asked),
        of.get_service_names_and_types_by_node(*asked),
    )
    publishes, hears, serves = ({name for name, _ in each} for each in found)
    return publishes, hears, serves


def mirrored(engine: Engine) -> tuple[int, tuple[str, ...]]:
    found = MIRRORED.of(link(engine))
    assert found is not None
    return found.nodes, found.left_out


def stand_here(engine: Engine, *nodes: str) -> bool:
    """Whether of the program's own nodes just these are mirrored: the domain may have other tests' nodes, too."""
    return inside(engine).context.shared(MirrorTable).links.keys() & {LIDAR, CAMERA} == {*nodes}


def exists(engine: Engine, node: str, domain: Domain) -> bool:
    """Whether a node is left out as its domain has one of that name."""
    return any(has_text(each, NotMirrored.EXISTS, node=node, domain=domain.id) for each in mirrored(engine)[1])


def test_nodes_stand_here_with_what_is_bridged(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    server = bridge.server(**ON)
    bridge.client(*TOPICS)
    wanted = {"/scan", "/plan"}, {"/speed"}, {"/front/reset"}
    pc.publisher("/speed")  # the bridge subscribes to what somebody publishes
    listener, plan = pc.listener("/scan"), pc.listener("/plan", qos=LATCHED)
    eventually(lambda: info(pc, LIDAR) == wanted, what="the lidar with what is bridged of it")
    assert names(pc).count(LIDAR) == 1
    eventually(lambda: CAMERA in names(pc), what="the camera, of which nothing is bridged")
    eventually(lambda: plan.texts(1) == ["the plan"], what="the latched message")
    assert happened(server, EventCode.ROUTE_MOVED) is None  # so it was sent once
    eventually(lambda: [each.node_name for each in pc.node.get_publishers_info_by_topic("/scan")] == ["lidar"])

    def crosses() -> bool:
        far.scan("near")
        return listener.texts(1) == ["near"]

    eventually(crosses, what="its message")
    with closing(Spun(pc.id, "caller")) as caller:
        client = caller.node.create_client(Trigger, "/front/reset")
        assert client.wait_for_service(20.0)
        assert client.call(Trigger.Request()).message == "well"
    far.end_lidar()
    eventually(lambda: LIDAR not in names(pc), what="its end")
    eventually(lambda: [each.node_name for each in pc.node.get_publishers_info_by_topic("/plan")] != ["lidar"])
    assert CAMERA in names(pc)
    assert stand_here(server, CAMERA)


def test_parameters_and_lifecycle_of_mirrored_nodes(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    """Patterns name no node: what the robot's own file lets the server call is offered on the mirrored node."""
    bridge.server(**ON)
    bridge.client(
        Topic("/**", "receive", kind="parameters"),
        Topic("/**/get_state", "receive", kind="service", type="lifecycle_msgs/srv/GetState"),
    )
    services = {f"{CAMERA}/{each}" for each in ("list_parameters", "get_parameters", "set_parameters", "get_state")}
    eventually(lambda: services <= info(pc, CAMERA)[2], what="its services")
    with closing(Spun(pc.id, "caller")) as caller:
        parameters = AsyncParameterClient(caller.node, CAMERA)
        assert parameters.wait_for_services(20.0)
        found = parameters.list_parameters()
        eventually(found.done, what="its parameters")
        assert "exposure" in found.result().result.names
        states = caller.node.create_client(GetState, f"{CAMERA}/get_state")
        assert states.wait_for_service(20.0)
        assert states.call(GetState.Request()).current_state.label == "unconfigured"


def test_node_that_exists_here_is_left_out(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    """Both domains have a node /stock. One that comes later ends the mirrored one, until it goes."""
    server = bridge.server(**ON)
    bridge.client(*TOPICS)
    eventually(lambda: LIDAR in names(pc), what="the lidar")
    assert names(pc).count("/stock") == 1
    eventually(lambda: exists(server, "/stock", pc), what="the reason")
    assert happened(server, MirrorCode.LEFT_OUT, NotMirrored.EXISTS, node="/stock", domain=pc.id)
    own = rclpy.create_node("lidar", namespace="/front", context=pc.context, start_parameter_services=False)
    eventually(lambda: names(pc).count(LIDAR) == 1, what="the mirrored one's end")
    eventually(lambda: exists(server, LIDAR, pc), what="the reason")
    own.destroy_node()
    eventually(lambda: info(pc, LIDAR) == ({"/scan", "/plan"}, set(), {"/front/reset"}), what="its return")


def test_nothing_stands_here_unless_the_session_asks(
    bridge: Bridge, far: FarProgram, pc: Domain, tmp_path: Path
) -> None:
    """A reload begins and ends it; topics and services go on by the bridge's own node."""
    server = bridge.server()
    bridge.client(*TOPICS)
    eventually(lambda: is_accepted(server, "/front/reset"), what="open")
    plan = pc.listener("/plan", qos=LATCHED)
    eventually(lambda: plan.texts(1) == ["the plan"], what="the latched message")
    assert MIRRORED.of(link(server)) is None
    assert LIDAR not in names(pc)
    path = tmp_path / "server.yaml"
    reloaded(server, path, **ON)
    eventually(lambda: info(pc, LIDAR) == ({"/scan", "/plan"}, set(), {"/front/reset"}), what="it stands here")
    assert happened(server, EventCode.ROUTE_MOVED) is not None
    late = pc.listener("/plan", qos=LATCHED)
    eventually(lambda: late.texts(1) == ["the plan"], what="the latched message, sent again")
    reloaded(server, path, features={})
    eventually(lambda: {LIDAR, CAMERA}.isdisjoint(names(pc)), what="its end")
    listener = pc.listener("/scan")

    def crosses() -> bool:
        far.scan("near")
        return listener.texts(1) == ["near"]

    eventually(crosses, what="a message")


def test_names_have_the_prefix_of_topics(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    bridge.server(use_name=True, **ON)
    bridge.client(*TOPICS)
    there = {"/robot1/scan", "/robot1/plan"}, set[str](), {"/robot1/front/reset"}
    eventually(lambda: info(pc, f"/robot1{LIDAR}") == there, what="the lidar with its prefix")
    eventually(lambda: "/robot1/stock" in names(pc), what="the other nodes")


def test_hidden_nodes_are_not_mirrored(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    server = bridge.server(**ON)
    client = bridge.client(*TOPICS, features={"show_nodes": False})
    eventually(lambda: linked(server) and mirrored(server)[1], what="the reason")
    assert has_text(mirrored(server)[1][0], NotMirrored.NOT_SHOWN)
    eventually(lambda: LIDAR not in names(pc), what="no node")
    assert mirrored(server)[0] == 0
    assert MIRRORED.of(link(client)) is None


def test_lost_link_ends_them_with_its_association(bridge: Bridge, far: FarProgram, pc: Domain) -> None:
    """What is latched stays for late joiners, on whichever node, and does not cross again."""
    server = bridge.server(outlive=0, **ON)
    client = bridge.client(*TOPICS, outlive=0)
    pc.publisher("/speed")
    eventually(lambda: info(pc, LIDAR) == ({"/scan", "/plan"}, {"/speed"}, {"/front/reset"}), what="the lidar")
    eventually(lambda: CAMERA in names(pc), what="the camera")
    present = pc.listener("/plan", qos=LATCHED)
    eventually(lambda: present.texts(1) == ["the plan"], what="the latched message")
    client.stop()
    eventually(lambda: stand_here(server), what="their end")
    eventually(lambda: not {LIDAR, CAMERA} & {*names(pc)}, what="their end as others see it")
    late = pc.listener("/plan", qos=LATCHED)
    eventually(lambda: late.texts(1) == ["the plan"], what="the latched message, of the bridge's own node")
    returned = bridge.client(*TOPICS)
    eventually(lambda: info(pc, LIDAR) == ({"/scan", "/plan"}, {"/speed"}, {"/front/reset"}), what="its return")
    eventually(lambda: CAMERA in names(pc), what="the camera")
    assert names(pc).count(LIDAR) == 1
    later = pc.listener("/plan", qos=LATCHED)
    eventually(lambda: later.texts(1) == ["the plan"], what="the latched message, of the lidar")
    assert happened(server, EventCode.ROUTE_MOVED) is None
    assert route(returned, "/plan").ledger.offered == 0


def on_loop(found: Link, work: Callable[[], None]) -> None:
    """Do something on the I/O thread, and wait for it."""
    done = threading.Event()

    def do() -> None:
        work()
        done.set()

    found.context.call(do)
    eventually(done.is_set, what="it is done")


def test_node_of_a_topic_need_not_be_listed(
    bridge: Bridge, far: FarProgram, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The list may have no room for it; else its latched topic would be sent again and again."""
    monkeypatch.setattr(LinkNodes, "tick", lambda _: None)  # so that no list comes
    server = bridge.server(**ON)
    bridge.client(*TOPICS)
    (found,) = inside(server).role.links()

    def reported() -> bool:
        return any(each.half.facts.nodes_there == (LIDAR,) for each in found.routes.values() if each.topic == "/plan")

    eventually(reported, what="the other side's report")
    mirrors = found.extensions.find(LinkMirrors)

    def look_late() -> None:
        with Place("rsb_extras.mirrored_nodes.link_mirrors", "_LISTED_WITHIN").during(0.0):
            mirrors.connected()
        mirrors.update()

    on_loop(found, look_late)
    assert stand_here(server, LIDAR)
    assert happened(server, EventCode.ROUTE_MOVED) is None


def test_nodes_of_a_quick_return_stay(
    bridge: Bridge, far: FarProgram, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link comes back before anybody has looked, and its topics before the list of nodes."""
    server = bridge.server(outlive=0, **ON)
    client = bridge.client(*TOPICS, outlive=0)
    eventually(lambda: {LIDAR, CAMERA} <= {*names(pc)}, what="the nodes")
    eventually(lambda: is_accepted(server, "/plan"), what="open")
    update = LinkMirrors.update
    with monkeypatch.context() as patch:
        patch.setattr(LinkMirrors, "update", lambda _: None)
        patch.setattr(LinkNodes, "tick", lambda _: None)
        client.stop()
        eventually(lambda: not linked(server), what="its end")
        bridge.client(*TOPICS)
        eventually(lambda: is_accepted(server, "/plan"), what="open again")
        (found,) = inside(server).role.links()
        on_loop(found, lambda: update(found.extensions.find(LinkMirrors)))
        assert stand_here(server, LIDAR, CAMERA)
    eventually(lambda: found.extensions.find(LinkNodes).book.nodes, what="the list")
    assert stand_here(server, LIDAR, CAMERA)
    assert happened(server, EventCode.ROUTE_MOVED) is None
