"""Changes of one book make another one like it; what has no room is later; and processes of real nodes."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import MOST_NODES, LogLine, NodeState, ProcessState
from rsb_extras.nodes.node_processes import NodeProcesses
from rsb_extras.nodes.tests.lidar_helpers import Looker

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

NAMES = tuple(f"/node_{number}" for number in range(6))
STEPS = st.lists(st.tuples(st.sampled_from(["put", "drop", "process", "end", "read"]), st.integers(0, 5)), max_size=40)


def process(pid: int, cpu: int = 0) -> ProcessState:
    return ProcessState(pid, "node", cpu, 10, 1, 0)


@given(STEPS, st.integers(0, 3))
def test_reader_has_what_the_writer_has(steps: list[tuple[str, int]], room: int) -> None:
    writer, reader, at = NodeBook(), NodeBook(), (0, 0)

    def read(most: int) -> None:
        nonlocal at
        left = most

        def may_send(_: int) -> bool:
            nonlocal left
            left -= 1
            return left >= 0

        changes = writer.changes(*at, 100, may_send)
        reader.take(changes, 107)
        at = changes.book, changes.number

    for number, (step, key) in enumerate(steps):
        match step:
            case "put":
                writer.put(NodeState(NAMES[key], publishes=number))
            case "end":
                writer.put(NodeState(NAMES[key], ended=50, line=LogLine(40, 40, str(number))))
            case "process":
                writer.put(process(key, number))
            case "drop":
                writer.drop(NAMES[key] if number % 2 else key)
            case _:
                read(room)
    read(100)
    assert reader.nodes.keys() == writer.nodes.keys()
    assert {name: each.publishes for name, each in reader.nodes.items()} == {
        name: each.publishes for name, each in writer.nodes.items()
    }
    assert {pid: each.cpu for pid, each in reader.processes.items()} == {
        pid: each.cpu for pid, each in writer.processes.items()
    }
    assert {each.ended for each in reader.nodes.values()} <= {None, 57}
    assert not writer.changes(*at, 100).nodes


def test_nodes_beyond_the_limit_are_left_out() -> None:
    book = NodeBook()
    for number in range(MOST_NODES + 5):
        book.put(NodeState(f"/{number}"))
    assert len(book.nodes) == MOST_NODES
    book.drop("/0")
    book.put(NodeState("/late"))
    assert "/late" in book.nodes


def test_process_is_found_by_its_participant_and_its_name() -> None:
    low = os.getpid().to_bytes(4, "little")[:2]
    own = b"\x01\x0f\x12\x34" + low + bytes(10)
    processes = NodeProcesses(own)
    assert processes.machine_of(own[:12]) == os.uname().nodename
    assert processes.machine_of(b"\x01\x0f\xab\xcd" + bytes(8)) == "host abcd"
    assert processes.machine_of(b"\x01\x10" + bytes(10)) == ""
    assert processes.pid_of(b"\x01\x0f\xab\xcd" + low + bytes(6)) == 0
    sleeping = (
        sys.executable,
        "-c",
        "import time; time.sleep(1000)",
        "--ros-args",
        "-r",
        "__node:=cook",
        "-r",
        "__ns:=/k",
    )
    with subprocess.Popen(sleeping) as child:
        try:
            find = lambda: processes.pid_by_name({"/k/cook", "/k/waiter"})  # noqa: E731 -- asked twice
            assert eventually(find, what="its command line") == {"/k/cook": child.pid}
            # In MB: one that begins just now has less.
            eventually(lambda: (found := processes.figures(child.pid, 1000.0)) is not None and found.memory > 0)
        finally:
            child.kill()
    assert processes.figures(child.pid, 1001.0) is None


@pytest.mark.usefixtures("long_lease")
def test_lifecycle_state_is_asked_and_followed(bridge: Bridge) -> None:
    server, _ = bridge.both()
    looker = Looker(server)
    node = Spun(bridge.robot.id, "managed", LifecycleNode)

    def state() -> str:
        found = looker.look().nodes.get("/managed")
        return "" if found is None else found.lifecycle

    try:
        eventually(lambda: state() == "unconfigured", what="its state")
        asked = ChangeState.Request()
        asked.transition.id = 1  # configure
        node.call(ChangeState, "/managed/change_state", asked)
        eventually(lambda: state() == "inactive", what="its next state")
    finally:
        node.close()
