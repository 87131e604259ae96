"""The command ``lifecycle``: its list, its question, and the steps of a change."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING, Any

from tests.support.bridge import linked
from tests.support.waiting import eventually

from rsb_console.command.shell import FAILURE, OK, USAGE
from rsb_extras.node_control.change_requests import ChangeNodes
from rsb_extras.node_control.target_names import target_names
from rsb_extras.node_control.tests.managed_nodes import ManagedNodes, has

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine
    from tests.support.domain import Domain

Run = Callable[..., "Ran"]


def told(machine: Machine) -> list[Any]:
    """Return the changes that an engine was told to carry out."""
    return [command[:4] for engine in machine.engines for command in engine.commands if command[0] == "change nodes"]


def test_nodes_and_groups_of_both_sides_are_listed(machine: Machine, ran: Run) -> None:
    machine.serve()
    listed = ran("lifecycle")
    assert listed.code == OK
    assert listed.out.splitlines() == [
        "NAME                 SIDE        STATE                       NOW POSSIBLE",
        "/camera              this side   active                      deactivate shutdown",
        "nav                  the server  1 inactive, 1 unconfigured  up down",
        "/controller          the server  unconfigured                no right",
        "/lidar_driver        the server  active                      deactivate shutdown",
        "/nav/planner_server  the server  inactive                    activate cleanup shutdown",
        "/silent              the server  no answer                   no right",
    ]
    found = ran("lifecycle", "--json").json
    assert found["ok"]
    assert [(node["link"], node["name"], node["state"]) for node in found["nodes"]][:2] == [
        ("", "/camera", "active"), ("robot1", "/controller", "unconfigured"),
    ]  # fmt: skip
    assert found["groups"][0]["nodes"] == ["/nav/planner_server", "/controller"]


def test_a_change_asks_first(machine: Machine, ran: Run) -> None:
    machine.serve()
    refused = ran("lifecycle", "activate", "/nav/planner_server")
    assert (refused.code, told(machine)) == (USAGE, [])
    assert "no operator can answer: give --yes" in refused.err
    done = ran("lifecycle", "activate", "/nav/planner_server", "--yes")
    assert (done.code, done.out.splitlines()) == (
        OK,
        [
            "  /nav/planner_server  activate  active  2.0 s",
            "/nav/planner_server of the server: activate: done in 2.0 s",
        ],
    )
    assert told(machine) == [("change nodes", "/nav/planner_server", "activate", "robot1")]


def test_a_refusal_is_the_last_step(machine: Machine, ran: Run) -> None:
    machine.serve()
    failed = ran("lifecycle", "down", "nav", "--yes")
    assert (failed.code, failed.out.splitlines()[-1]) == (
        FAILURE, "  /controller  configure  /controller refused to configure  0.3 s"
    )  # fmt: skip
    assert "nav of the server: down: /controller refused to configure, and is unconfigured now" in failed.err
    found = ran("lifecycle", "down", "nav", "--yes", "--json")
    assert found.code == FAILURE
    assert (found.json["ok"], len(found.json["steps"]), found.json["target"]) == (False, 2, "nav")


def test_wrong_usage_names_the_remedy(machine: Machine, ran: Run) -> None:
    machine.serve()
    assert "name the node or the group" in ran("lifecycle", "up").err
    unknown = ran("lifecycle", "up", "/base", "--yes")
    assert (unknown.code, told(machine)) == (USAGE, [])
    assert "no managed node and no group /base; there are: /camera, /controller" in unknown.err
    assert "there are: /camera" in ran("lifecycle", "up", "nav", "--here", "--yes").err


def test_a_real_group_comes_up(bridge: Bridge, machine: Machine, ran: Run, robot: Domain) -> None:
    with closing(ManagedNodes(robot.id, "planner", "controller")) as nodes:
        there = bridge.client(features=has("nav", nav=("/planner", "/controller")))
        pc = machine.have(bridge.server())
        eventually(lambda: linked(pc) and linked(there), what="linked")
        eventually(lambda: ran("lifecycle").out.count("unconfigured") >= 3, what="the nodes")
        up = ran("lifecycle", "up", "nav", "--yes")
        assert up.code == OK
        assert [line.split()[:3] for line in up.out.splitlines()[:-1]] == [
            [f"/{name}", step, state]
            for step, state in (("configure", "inactive"), ("activate", "active"))
            for name in ("planner", "controller")
        ]
        assert up.out.splitlines()[-1].startswith("nav of robot1: up: done in ")
        assert ran("lifecycle", "up", "nav", "--yes").out == "nav of robot1: up: nothing to do\n"
        assert len(nodes.taken) == 4
        assert ChangeNodes("nav", "up").expires


def test_names_are_completed(machine: Machine, here: None) -> None:
    machine.serve()
    assert target_names(Namespace()) == [
        "/camera",
        "nav",
        "/controller",
        "/lidar_driver",
        "/nav/planner_server",
        "/silent",
    ]
