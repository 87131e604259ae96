"""Two bridges over a socket: parameters of one side's node are read and set from the other, as far as its rights go."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.parameter import Parameter
from tests.support.bridge import happened
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import acting
from rsb_bridge.model.session import Topic
from rsb_extras.node_control.change_requests import ChangeNodes
from rsb_extras.node_control.node_changer import ChangeCode
from rsb_extras.node_control.parameter_records import (
    LARGEST_CHANGE,
    LARGEST_VALUE,
    NewValue,
    NodeParameter,
    ParameterRange,
    ParameterValue,
)
from rsb_extras.node_control.parameter_requests import ListParameterNodes, ReadParameters
from rsb_extras.node_control.parameter_rules import ParameterChange
from rsb_extras.node_control.tests.managed_nodes import has, linked_sides
from rsb_extras.node_control.tests.tuned_node import LARGE, VALUES, TunedNode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_extras.node_control.change_records import ChangeOutcome

NODE = "/controller"


@pytest.fixture
def node(robot: Domain) -> Iterator[TunedNode]:
    with closing(TunedNode(robot.id)) as made:
        yield made


def two_sides(bridge: Bridge, *may: str, **others: Any) -> tuple[Engine, Engine]:
    """Return the control PC, and the robot that lets it have some nodes changed."""
    pc, robot = linked_sides(bridge, has(*may) | others.pop("features", {}), **others)
    eventually(lambda: NODE in own_nodes(robot), what="the node's services")
    return pc, robot


def own_nodes(engine: Engine) -> list[str]:
    sides = engine.do(ListParameterNodes()).result(60)
    return [each.name for side in sides if not side.link for each in side.nodes]


def read(engine: Engine, *names: str, link: str = "robot1", whole: bool = False) -> dict[str, NodeParameter]:
    found = engine.do(ReadParameters(NODE, names, whole, link)).result(60)
    return {each.name: each for each in found}


def new(name: str, kind: Any, plain: Any) -> NewValue:
    return NewValue(name, ParameterValue.of(kind, plain))


def change(engine: Engine, *values: NewValue, link: str = "robot1", target: str = NODE) -> ChangeOutcome:
    return engine.do(ChangeNodes(target, "set", link, values)).result(120)


def test_all_parameters_cross_with_their_descriptors(bridge: Bridge, node: TunedNode) -> None:
    pc, robot = two_sides(bridge, NODE)
    found = read(pc)
    assert list(found) == sorted(found)
    plain = {name: parameter.value.plain() for name, parameter in found.items() if not parameter.size}
    expected = {**VALUES, "raw": [0, 255], "max_speed": 0.5, "count": 4, "serial": "A-17", "any": 1, "unset": None}
    assert plain.items() >= expected.items()
    assert found["max_speed"].ranges == (ParameterRange(0.0, 2.0, 0.1),)
    assert found["max_speed"].description == "m/s, in the plane"
    assert found["max_speed"].constraints == "below the robot's own"
    assert found["unset"].value == ParameterValue("double")
    assert found["count"].ranges == (ParameterRange(0, 10, 2),)
    assert isinstance(found["count"].ranges[0].low, int)
    assert (found["serial"].read_only, found["any"].dynamic) == (True, True)
    assert found == read(robot, link=""), "of one's own side the same"
    assert {side.link: [each.allowed for each in side.nodes if each.name == NODE] for side in sides(pc)} == {
        "robot1": [True]
    }


def sides(engine: Engine) -> Any:
    return engine.do(ListParameterNodes()).result(60)


def test_a_large_value_is_left_out_unless_it_is_wanted(bridge: Bridge, node: TunedNode) -> None:
    pc, _ = two_sides(bridge, NODE)
    listed = read(pc)["description"]
    assert (listed.value, listed.size > 100_000) == (ParameterValue("string"), True)
    assert read(pc, "description", whole=True)["description"].value.plain() == LARGE
    assert read(pc, whole=True)["description"].value.plain() == LARGE
    node.node.set_parameters([type(node.node.get_parameter("frame"))("frame", value="y" * LARGEST_VALUE)])
    assert read(pc, "frame", whole=True)["frame"].size > LARGEST_VALUE


def test_names_choose_and_pages_follow_each_other(bridge: Bridge, node: TunedNode) -> None:
    for number in range(450):
        node.node.declare_parameter(f"many.p{number}", number)
    pc, _ = two_sides(bridge, NODE)
    found = read(pc)
    assert [found[f"many.p{number}"].value.plain() for number in range(450)] == [*range(450)]
    assert [*read(pc, "frame", "nothing", "count")] == ["count", "frame"]
    wanted = [f"many.p{number}" for number in range(150)]
    assert [*read(pc, *wanted)] == sorted(wanted)


def test_some_are_set_all_or_none(bridge: Bridge, node: TunedNode) -> None:
    pc, robot = two_sides(bridge, NODE)
    values = [
        new("max_speed", "double", 1.2), new("gains", "double_array", []), new("raw", "byte_array", b"\x01"),
        new("flags", "bool_array", [False]), new("ids", "integer_array", [7]), new("names", "string_array", ["ü", ""]),
        new("frame", "string", "odom"), new("enabled", "bool", False), new("any", "string", "now a text"),
    ]  # fmt: skip
    with acting("anna on pts/3"):
        done = change(pc, *values)
    assert (done.done, done.reason, [step.what for step in done.steps]) == (True, "", ["set"])
    assert (node["max_speed"], [*node["gains"]], node["raw"], node["enabled"]) == (1.2, [], [b"\x01"], False)
    assert ([*node["ids"]], node["names"], node["frame"], node["any"]) == ([7], ["ü", ""], "odom", "now a text")
    event = happened(robot, ChangeCode.BEGAN, f"{NODE}: set max_speed = 1.2, gains = [], raw = [1] and 6 more")
    assert event is not None
    assert event.who == "the server, which says: anna on pts/3"
    assert happened(pc, ChangeCode.BEGAN, f"{NODE} of robot1: set max_speed = 1.2, gains = []")
    assert happened(pc, ChangeCode.ENDED, f"{NODE} of robot1: set: done in ")
    failed = change(pc, new("frame", "string", "map"), new("max_speed", "double", 9.0))
    assert failed.reason.startswith(f"{NODE} does not set frame and max_speed: "), failed.reason
    assert (node["frame"], node["max_speed"]) == ("odom", 1.2)


def test_a_value_that_is_another_by_now_is_not_set(bridge: Bridge, node: TunedNode) -> None:
    pc, robot = two_sides(bridge, NODE)
    seen = read(pc)
    meant = ParameterChange(seen["frame"], "string", "odom"), ParameterChange(seen["max_speed"], "double", 1.0)
    node.node.set_parameters([Parameter("frame", value="world")])
    for engine, link in ((pc, "robot1"), (robot, "")):
        refused = change(engine, *(each.value for each in meant), link=link)
        assert refused.reason == f"frame of {NODE} is world by now, and not what was seen before: read it again"
    assert (node["frame"], node["max_speed"]) == ("world", 0.5)
    unset = ParameterChange(read(pc)["unset"], "double", 2.0)
    assert change(pc, ParameterChange(read(pc)["frame"], "string", "odom").value, unset.value).done
    assert (node["frame"], node["unset"]) == ("odom", 2.0)


def test_a_nodes_reason_is_shown(bridge: Bridge, node: TunedNode) -> None:
    pc, robot = two_sides(bridge, NODE)
    node.refused = "not while it drives"
    assert change(pc, new("frame", "string", "odom")).reason == (f"{NODE} does not set frame: not while it drives")
    assert change(robot, new("frame", "string", "odom"), link="").reason.endswith("not while it drives")
    assert happened(robot, ChangeCode.FAILED, "not while it drives")


def test_without_the_right_nothing_is_read_or_set(bridge: Bridge, node: TunedNode) -> None:
    pc, robot = two_sides(bridge)
    refused = change(pc, new("frame", "string", "odom"))
    assert refused.refused
    assert refused.reason.startswith(f"robot1 does not let the server change {NODE}: add may: {{nodes: [{NODE}]}}")
    assert node["frame"] == "map"
    with pytest.raises(EngineError, match=f"robot1 does not let the server read parameters of {NODE}: add may:"):
        read(pc)
    assert change(robot, new("frame", "string", "odom"), link="").done
    assert node["frame"] == "odom"


def test_an_entry_with_arm_gives_the_right_while_armed(
    bridge: Bridge, node: TunedNode, consoles: Consoles, long_lease: None
) -> None:
    there, _ = two_sides(bridge, topics=(Topic(NODE, "receive", kind="parameters", arm=True),))
    eventually(lambda: any(route.topic == NODE for route in there.snapshot().routes), what="the entry's route")
    assert change(there, new("frame", "string", "odom")).refused
    consoles.arm(there, NODE)
    assert change(there, new("frame", "string", "odom")).done
    assert read(there)["frame"].value.plain() == node["frame"] == "odom"


def test_hidden_nodes_are_not_listed(bridge: Bridge, node: TunedNode) -> None:
    pc, _ = two_sides(bridge, features={"show_nodes": False})
    assert sides(pc) == ()


def test_hidden_nodes_that_may_be_changed_are_read(bridge: Bridge, node: TunedNode) -> None:
    pc, _ = two_sides(bridge, NODE, features={"show_nodes": False})
    assert read(pc)["frame"].value.plain() == "map"
    assert [each.name for side in sides(pc) if side.link for each in side.nodes] == [NODE]


def test_parameters_of_a_driven_node_are_left_alone(
    bridge: Bridge, node: TunedNode, pc: Domain, consoles: Consoles, long_lease: None
) -> None:
    from std_msgs.msg import String

    node.node.create_subscription(String, "/cmd", print, 10)
    pc.publisher("/cmd")
    there, here = two_sides(bridge, NODE, topics=(Topic("/cmd", "receive", arm=True),))
    consoles.arm(there)
    assert change(there, new("frame", "string", "odom")).reason.startswith("/cmd is armed")
    assert node["frame"] == "map"
    assert change(here, new("frame", "string", "odom"), link="").done


@pytest.mark.parametrize(
    ("target", "values"),
    [
        (NODE, ()),
        ("nav", (new("frame", "string", "odom"),)),
        (NODE, (new("frame", "string", "odom"), new("frame", "string", "map"))),
        (NODE, (NewValue("frame", ParameterValue("double", b"\xa1x")),)),
        (NODE, (new("frame", "string", "x" * LARGEST_CHANGE),)),
    ],
)
def test_what_is_no_change_reaches_no_node(bridge: Bridge, node: TunedNode, target: str, values: Any) -> None:
    pc, robot = two_sides(bridge, NODE)
    assert change(robot, *values, link="", target=target).refused
    with pytest.raises(EngineError, match="a change sets 1 to 200 parameters of one node"):
        change(pc, *values, target=target)
    assert node["frame"] == "map"


def test_nodes_that_give_none_are_named(bridge: Bridge, node: TunedNode) -> None:
    pc, _ = two_sides(bridge, NODE, "/nobody")
    with pytest.raises(EngineError, match="/nobody does not run, or has no service /list_parameters"):
        pc.do(ReadParameters("/nobody", link="robot1")).result(60)
    with pytest.raises(EngineError, match="is neither a node's full name nor a group's"):
        pc.do(ReadParameters("/no body", link="robot1")).result(60)
