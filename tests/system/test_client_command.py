"""`rsb-console client` on a server that runs in a process of its own, with clients in others."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace
from tests.support.bridge import link, linked
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import load
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs

COMMAND = str(Path(sys.executable).with_name("rsb-console"))


def client(name: str, path: Path, *arguments: str) -> Any:
    """Run the command for a session file and the program that runs it; its answer."""
    command = [COMMAND, "client", name, *arguments, str(path), "--control", f"{path}.sock", "--json"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_a_robot_joins_and_leaves_a_fleet_that_runs(
    bridge: Bridge, programs: Programs, robot: Domain, pc: Domain
) -> None:
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server = programs.start(bridge.server_session())
    path = bridge.folder / "server0.yaml"
    first = bridge.client(Topic("/chat", "transmit"))
    eventually(lambda: linked(first))
    since = link(first).since

    added = client("add", path, "--address", "127.0.0.1", "robot2")
    assert "it lets the client in from now on" in added["running"]
    robots = bridge.folder / "robot2.yaml"
    robots.write_text(added["client_session"])
    second = bridge.start(replace(load(robots), domain_id=robot.id))
    eventually(lambda: linked(second, "robot2"))
    states = {each["name"]: each["state"] for each in client("list", path)["clients"]}
    assert states["robot1"] == "ok"

    client("rekey", path, "robot2")
    eventually(lambda: not linked(second, "robot2"), what="the old key counts no more")
    again = bridge.start(replace(load(robots), domain_id=robot.id))
    eventually(lambda: linked(again, "robot2"), what="the new key does")

    client("remove", path, "robot2")
    eventually(lambda: "no client of the name 'robot2'" in link(again, "robot2").reason)

    def hears() -> bool:  # the server's process may not have discovered the listener when the first is published
        out.publish(text("all the way"))
        return bool(there.texts(last=1))

    eventually(hears)
    assert there.texts(last=1) == ["all the way"]
    assert link(first).since == since
    server.wait_for("client robot2: removed")
