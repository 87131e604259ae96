"""The command ``param``: its lists, its question, and files that are written, compared and loaded."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from rclpy.parameter import parameter_dict_from_yaml_file
from tests.support.bridge import linked
from tests.support.waiting import eventually

from rsb_bridge.model.text import is_clean
from rsb_console.command.shell import FAILURE, OK, USAGE
from rsb_console.session.parameter_files import parameters_text, read_parameter_file
from rsb_console.session.parameter_values import parameter_value, shown_value
from rsb_extras.node_control.target_names import nodes_with_parameters, parameter_names
from rsb_extras.node_control.tests.managed_nodes import has
from rsb_extras.node_control.tests.tuned_node import LARGE, VALUES, TunedNode

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine
    from tests.support.domain import Domain

Run = Callable[..., "Ran"]
NODE = "/nav/planner_server"


def told(machine: Machine) -> list[Any]:
    """Return the changes that an engine was told to carry out."""
    found = [command for engine in machine.engines for command in engine.commands if command[0] == "change nodes"]
    return [(*command[1:4], [(each.name, each.value.plain()) for each in command[4]]) for command in found]


def test_nodes_and_parameters_are_listed(machine: Machine, ran: Run) -> None:
    machine.serve()
    assert [line.split() for line in ran("param", "list").out.splitlines()] == [
        ["NAME", "SIDE"],
        ["/camera", "this", "side"],
        ["/controller", "the", "server", "no", "right"],
        ["/lidar_driver", "the", "server"],
        [NODE, "the", "server"],
    ]
    listed = ran("param", "list", NODE)
    assert listed.code == OK
    assert listed.out.splitlines() == [
        "NAME             VALUE                   TYPE          ABOUT",
        "description      (string, 80,000 bytes)  string",
        "frame            map                     string",
        "max_speed        0.5                     double        0 to 2 in steps of 0.1; m/s, in the plane",
        "planner.plugins  [grid, smac]            string_array",
        "retries          4                       integer       0 to 10 in steps of 2",
        "serial           A-17                    string        read-only",
        "use_sim_time     false                   bool",
    ]
    found = ran("param", "list", NODE, "--json").json
    assert (found["ok"], found["link"]) == (True, "robot1")
    assert found["parameters"][2] == {
        "name": "max_speed", "type": "double", "value": 0.5, "size": 0, "read_only": False, "dynamic": False,
        "description": "m/s, in the plane", "constraints": "", "range": {"low": 0.0, "high": 2.0, "step": 0.1},
    }  # fmt: skip


def test_a_change_asks_first_and_shows_old_and_new(machine: Machine, ran: Run) -> None:
    machine.serve()
    refused = ran("param", "set", NODE, "max_speed", "1", "frame", "odom")
    assert (refused.code, told(machine)) == (USAGE, [])
    assert "no operator can answer: give --yes" in refused.err
    done = ran("param", "set", NODE, "max_speed", "1", "frame", "7", "--yes")
    assert (done.code, done.out.splitlines()) == (
        OK,
        ["  frame: map → '7'", "  max_speed: 0.5 → 1.0", f"{NODE} of the server: set: done in 2.0 s"],
    )
    assert told(machine) == [(NODE, "set", "robot1", [("frame", "7"), ("max_speed", 1.0)])]
    found = ran("param", "set", NODE, "frame", "odom", "--yes", "--json").json
    assert (found["ok"], found["changed"]) == (True, [{"name": "frame", "type": "string", "old": "map", "new": "odom"}])


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("max_speed", "2.5", "2.5 is not in its range, 0 to 2 in steps of 0.1"),
        ("max_speed", "0.55", "0.55 is no step of its range, 0 to 2 in steps of 0.1"),
        ("max_speed", ".nan", ".nan is not in its range, 0 to 2 in steps of 0.1"),
        ("max_speed", "fast", "this is no double"),
        ("retries", "3", "3 is no step of its range, 0 to 10 in steps of 2"),
        ("retries", "4.0", "this is no integer"),
        ("serial", "B-1", "it is read-only"),
        ("use_sim_time", "yes", "this is no bool"),
        ("planner.plugins", "[1]", "this is no array of strings"),
        ("nothing", "1", "has no parameter nothing"),
    ],
)
def test_what_cannot_be_set_is_not_asked_for(machine: Machine, ran: Run, name: str, value: str, why: str) -> None:
    machine.serve()
    refused = ran("param", "set", NODE, name, value, "--yes")
    assert refused.code == FAILURE
    assert why in refused.err
    assert told(machine) == []


def test_a_nodes_refusal_has_its_reason(machine: Machine, ran: Run) -> None:
    machine.serve()
    failed = ran("param", "set", NODE, "retries", "6", "--yes")
    assert failed.code == FAILURE
    assert "set: /controller does not set retries: not while it drives" in failed.err
    found = ran("param", "set", NODE, "retries", "6", "--yes", "--json")
    assert (found.code, found.json["ok"], found.json["changed"]) == (FAILURE, False, [])


def test_wrong_usage_names_the_remedy(machine: Machine, ran: Run) -> None:
    machine.serve()
    assert "frame has no value" in ran("param", "set", NODE, "frame").err
    unknown = ran("param", "list", "/base")
    assert (unknown.code, "there are: /camera, /controller" in unknown.err) == (USAGE, True)
    assert "no such file" in ran("param", "load", NODE, "missing.yaml").err


def test_a_file_is_compared_and_loaded(machine: Machine, ran: Run, tmp_path: Path) -> None:
    machine.serve()
    path = tmp_path / "nav.yaml"
    path.write_text(
        "/**:\n  ros__parameters: {use_sim_time: true, frame: world}\n"
        "nav:\n  planner_server:\n    ros__parameters:\n"
        "      frame: map\n      max_speed: 1\n      planner: {plugins: []}\n      serial: B-1\n      ghost: 1\n"
    )
    shown = ran("param", "diff", NODE, str(path))
    assert (shown.code, shown.out.splitlines()) == (
        FAILURE,
        [
            "use_sim_time: false → true",
            "max_speed: 0.5 → 1.0",
            "planner.plugins: [grid, smac] → []",
            "serial is left out: it is read-only",
            "ghost is left out: the node has no such parameter",
        ],
    )
    loaded = ran("param", "load", NODE, str(path), "--yes")
    assert loaded.code == OK
    assert told(machine) == [
        (NODE, "set", "robot1", [("use_sim_time", True), ("max_speed", 1.0), ("planner.plugins", [])])
    ]
    assert "serial is left out: it is read-only" in loaded.err
    found = ran("param", "load", NODE, str(path), "--yes", "--json").json
    assert found["left_out"] == {"serial": "it is read-only", "ghost": "the node has no such parameter"}
    path.write_text(f"{NODE}: {{ros__parameters: {{frame: map}}}}\n")
    assert ran("param", "diff", NODE, str(path)).code == OK
    assert "nothing to set" in ran("param", "load", NODE, str(path)).out


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "has no parameters"), ("[1]\n", "nav.yaml:1: is no mapping of names"),
        ("/other: {ros__parameters: {a: 1}}\n", "has no parameters of /nav/planner_server, but of /other"),
        ("/**: {ros__parameters: {a: 1, a: 2}}\n", "nav.yaml:1: a has two values"),
        ("/**: {ros__parameters: {a: {b: 1}, a.b: 2}}\n", "nav.yaml:1: a.b has two values"),
        ("/**: {ros__parameters: {max_speed: 9.0}}\n", "max_speed of /nav/planner_server cannot be set: 9.0 is not in"),
        ("/**: {ros__parameters: {frame: null, max_speed: {}}}\n", "frame: odom"),
        ("/**: {ros__parameters: &x {a: *x}}\n", "aliases (*) are not allowed"),
    ],
)  # fmt: skip
def test_a_wrong_file_sets_nothing(machine: Machine, ran: Run, tmp_path: Path, text: str, why: str) -> None:
    machine.serve()
    path = tmp_path / "nav.yaml"
    path.write_text(text)
    refused = ran("param", "load", NODE, str(path), "--yes")
    assert told(machine) == [] or why == "frame: odom"
    assert why in refused.err or why == "frame: odom"


def test_a_real_node_is_saved_changed_and_restored(
    bridge: Bridge, machine: Machine, ran: Run, robot: Domain, tmp_path: Path
) -> None:
    """The file is one that `ros2 param load` reads."""
    path, node = tmp_path / "controller.yaml", "/controller"
    with closing(TunedNode(robot.id)) as tuned:
        there = bridge.client(features=has(node))
        pc = machine.have(bridge.server())
        eventually(lambda: linked(pc) and linked(there), what="linked")
        eventually(lambda: node in ran("param", "list").out, what="the node")
        dumped = ran("param", "dump", node, "--output", str(path))
        assert (dumped.code, dumped.err) == (OK, "")
        read = parameter_dict_from_yaml_file(str(path), target_nodes=[node])
        assert {"planner.tolerance", "planner.plugin.name", "frame", "max_speed"} <= {*read}
        nested = yaml.safe_load(path.read_text())[node]["ros__parameters"]
        assert nested["planner"] == {"plugin": {"name": "grid"}, "tolerance": 0.25}
        assert (nested["description"], nested["raw"], nested["ids"]) == (LARGE, [0, 255], VALUES["ids"])
        assert ran("param", "dump", node).out == path.read_text()
        assert ran("param", "diff", node, str(path)).code == OK
        changed = ran("param", "set", node, "max_speed", "1.2", "raw", "[1]", "gains", "[]", "any", "a text", "--yes")
        assert (changed.code, changed.err) == (OK, "")
        assert (tuned["max_speed"], tuned["raw"], [*tuned["gains"]], tuned["any"]) == (1.2, [b"\x01"], [], "a text")
        assert ran("param", "diff", node, str(path)).out.splitlines() == [
            "any: a text → 1", "gains: [] → [1.5, -2.0]", "max_speed: 1.2 → 0.5", "raw: [1] → [0, 255]",
        ]  # fmt: skip
        assert ran("param", "load", node, str(path), "--yes").code == OK
        assert ran("param", "diff", node, str(path)).code == OK
        assert (tuned["max_speed"], tuned["any"]) == (0.5, 1)
        assert LARGE.splitlines()[1] in ran("param", "get", node, "description").out
        assert ran("param", "get", node, "unset", "--json").json["parameters"][0]["value"] is None
        tuned.refused = "not while it drives"
        assert "not while it drives" in ran("param", "set", node, "frame", "odom", "--yes").err


def test_any_names_are_written_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "any.yaml"
    values = {
        "a": 1, "a.b": 2.5, "a.b.c": "0o7", "d.e": "yes", "d.f.g": [], "x..y": float("inf"), ".z": "", "end.": "a: b",
        "deep." * 30 + "x": True, "q./parameter_events.depth": ["1", "null", "1.0", "\ttab\n"],
    }  # fmt: skip
    path.write_text(parameters_text("/ns/any", values))
    read = read_parameter_file(path, "/ns/any")
    kinds = {"d.f.g": "integer_array", "a.b.c": "string"}
    assert {name: each.meant(kinds.get(name, ""))[1] for name, each in read.items()} == values
    assert {*parameter_dict_from_yaml_file(str(path), target_nodes=["/ns/any"])} == {*values}


@pytest.mark.parametrize("plain", ["a\nb: c\n", ["x\r\n", "\x1b[2J"], "\u200bhidden\u2028", "tab\there", 'quote"\n'])
def test_a_text_of_many_lines_is_shown_on_one_and_read_again(plain: str | list[str]) -> None:
    shown = shown_value(plain)
    assert is_clean(shown)
    assert parameter_value(shown)[1] == plain


def test_names_are_completed(machine: Machine, here: None) -> None:
    machine.serve()
    assert nodes_with_parameters(Namespace()) == ["/camera", "/controller", "/lidar_driver", NODE]
    assert parameter_names(Namespace(node=NODE))[:3] == ["description", "frame", "max_speed"]
    assert parameter_names(Namespace(node="/nothing")) == []
