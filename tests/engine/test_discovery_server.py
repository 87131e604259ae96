"""A bridge on a robot whose nodes find each other by a discovery server of Fast DDS, or not at all.

Its bridge has a process of its own: what Fast DDS has read of a server holds for all later participants of a process.
"""

from __future__ import annotations

import json
import subprocess
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tests.support.bridge import route
from tests.support.discovery_server import discovery_server, talker
from tests.support.forker import Forked
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.discovery import DiscoveryText

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.wording import Wording


def test_robot_with_a_discovery_server(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Whether it answers is named where the publisher is missed; then all that nodes publish is seen, and crosses."""
    port, heard, server = free_port(), pc.listener("/said"), bridge.server()
    listed = {"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port}"}
    with _robot(bridge, ROS_SUPER_CLIENT="False", **listed) as notes:
        eventually(lambda: _noted(notes, DiscoveryText.SUPER_CLIENT))
        eventually(lambda: _misses(server, DiscoveryText.SILENT))
        eventually(lambda: _noted(notes, DiscoveryText.SILENT))
        with discovery_server(port):
            eventually(lambda: _misses(server, DiscoveryText.ANSWERS))
            eventually(lambda: _noted(notes, DiscoveryText.ANSWERS))
            with talker(robot.id, "/said", **listed):
                eventually(lambda: heard.payloads)


def test_range_that_is_off_is_named(bridge: Bridge) -> None:
    server = bridge.server()
    with _robot(bridge, ROS_AUTOMATIC_DISCOVERY_RANGE="OFF") as notes:
        eventually(lambda: _noted(notes, DiscoveryText.OFF))
        eventually(lambda: _misses(server, DiscoveryText.OFF))


@contextmanager
def _robot(bridge: Bridge, **environ: str) -> Iterator[list[str]]:
    """Run the robot's bridge; what its log says of discovery."""
    path, notes = bridge.folder / "robot1.yaml", list[str]()
    save(bridge.client_session(Topic("/said", "transmit")), path)
    command = ("rsb_console", "run", "--no-ui", "--log-format", "json", str(path))

    def read() -> None:
        assert run.stdout is not None
        events = (json.loads(line) for line in run.stdout)
        notes.extend(each["text"] for each in events if each.get("code") == EventCode.ENGINE_DISCOVERY)

    with Forked(*command, stdout=subprocess.PIPE, environ=environ) as run:
        reading = threading.Thread(target=read)
        reading.start()
        try:
            yield notes
        finally:
            run.terminate()
            reading.join()


def _misses(server: Engine, text: Wording) -> bool:
    found = route(server, "/said")
    return found.cause == Cause.NO_PUBLISHER and says(found.reason, text)


def _noted(notes: list[str], text: Wording) -> bool:
    return any(says(note, text) for note in notes)
