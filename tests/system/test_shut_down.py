"""A robot without a console whose server shuts the links down: nobody has to walk to it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.support.bridge import linked
from tests.support.waiting import eventually, holds

from rsb_bridge.model.command_origin import acting

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.program import Programs

COMMAND = str(Path(sys.executable).with_name("rsb-console"))


def ask(bridge: Bridge, *arguments: str) -> Any:
    """Run a command on the robot."""
    socket = bridge.folder / "client0.yaml.sock"
    command = [COMMAND, *arguments, "--control", str(socket), "--json"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=False).stdout)


def test_a_robot_that_its_server_shuts_down_stays_up_and_is_let_in_again(bridge: Bridge, programs: Programs) -> None:
    server = bridge.server()
    robot = programs.start(bridge.client_session())
    eventually(lambda: linked(server))
    with acting("anna on pts/3"):
        server.shut_down().result(60)

    def is_shut_down() -> Any:
        said = ask(bridge, "status")  # without links where the program is too slow to say who it is
        return said if "links" in said and said["links"]["robot1"]["cause"] == "shut_down" else None

    status = eventually(is_shut_down)
    assert not status["ok"]
    assert "anna on pts/3" in status["links"]["robot1"]["reason"]
    assert ask(bridge, "retry")["ok"]
    eventually(lambda: server.snapshot().links[0].attempts)
    holds(lambda: robot.running and not linked(server), 1.0)
    server.retry("robot1").result(60)
    assert ask(bridge, "retry")["ok"]  # else it would ask within 36 s
    eventually(lambda: linked(server))
    assert robot.running
