"""`rsb-console client` on a server that runs in a process of its own, with clients in others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace
from tests.support.bridge import link, linked
from tests.support.commands import rsb_console
from tests.support.domain import text
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import LinkCause
from rsb_console.command.client_command import ClientEffect

if TYPE_CHECKING:
    import subprocess

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs


def run(name: str, path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command for a session file and the program that runs it."""
    return rsb_console("client", name, str(path), *arguments, "--control", f"{path}.sock", "--json")


def client(name: str, path: Path, *arguments: str) -> Any:
    """Run the command, which succeeds; its answer."""
    done = run(name, path, *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def used(path: Path) -> str:
    """Return the fingerprint of robot1's key in the server's status."""
    done = rsb_console("status", "--control", f"{path}.sock", "--json")
    link: dict[str, str] = json.loads(done.stdout).get("links", {}).get("robot1", {"state": ""})
    return link["fingerprint"] if link["state"] == "ok" else ""


def test_robot_joins_and_leaves_fleet_that_runs(bridge: Bridge, programs: Programs, robot: Domain, pc: Domain) -> None:
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server = programs.start(bridge.server_session())
    path = bridge.folder / "server0.yaml"
    first = bridge.client(Topic("/chat", "transmit"))
    eventually(lambda: linked(first))
    since = link(first).since

    added = client("add", path, "--address", "127.0.0.1", "robot2")
    assert says(added["running"], ClientEffect.ADDED)
    robots = bridge.folder / "robot2.yaml"
    robots.write_text(added["client_session"])
    second = bridge.start(replace(load(robots), domain_id=robot.id))
    eventually(lambda: linked(second, "robot2"))
    eventually(lambda: {each["name"]: each["state"] for each in client("list", path)["clients"]}["robot1"] == "ok")

    client("rekey", path, "robot2")
    eventually(lambda: not linked(second, "robot2"), what="the old key counts no more")
    again = bridge.start(replace(load(robots), domain_id=robot.id))
    eventually(lambda: linked(again, "robot2"), what="the new key does")

    client("remove", path, "robot2")
    eventually(lambda: link(again, "robot2").cause == LinkCause.UNKNOWN_NAME)

    def hears() -> bool:  # the server's process may not have discovered the listener when the first is published
        out.publish(text("all the way"))
        return bool(there.texts(last=1))

    eventually(hears)
    assert there.texts(last=1) == ["all the way"]
    assert link(first).since == since
    server.wait_for("client robot2: removed")


def test_a_key_is_replaced_in_the_documented_steps(bridge: Bridge, programs: Programs) -> None:
    """The link connects again once, when the robot takes the new key."""
    folder = bridge.folder
    robot_key = folder / "robot.key"
    robot_key.write_bytes((folder / bridge.key_file).read_bytes())
    server = programs.start(bridge.server_session())
    path = folder / "server0.yaml"
    robot = bridge.client(key_file=robot_key.name)
    save(robot.session, folder / "robot.yaml")
    robot.use_file(folder / "robot.yaml")
    eventually(lambda: linked(robot))
    old = link(robot).fingerprint
    since = link(robot).since

    eventually(lambda: client("list", path)["clients"][0]["state"] == "ok", what="the server's status has it, too")
    begun = client("rekey", path, "--keep-old", "robot1")
    assert "the link stays" in begun["running"]
    (row,) = client("list", path)["clients"]
    assert (row["state"], row["fingerprint"], row["next_fingerprint"]) == ("ok", old, begun["fingerprint"])
    refused = run("rekey", path, "--finish", "robot1")
    assert (refused.returncode, json.loads(refused.stdout)["ok"]) == (1, False)
    assert link(robot).since == since

    robot_key.write_bytes(Path(begun["key_file"]).read_bytes())
    robot.reload().result(60)
    eventually(lambda: linked(robot) and link(robot).fingerprint == begun["fingerprint"])
    since = link(robot).since
    eventually(lambda: used(path) == begun["fingerprint"], what="the server's status has it, too")
    finished = client("rekey", path, "--finish", "robot1")
    assert "the link stays" in finished["running"]
    assert finished["fingerprint"] == begun["fingerprint"]
    server.wait_for("next key")
    assert link(robot).since == since
    ups = [event for event in robot.events() if event.code == EventCode.LINK_UP]
    assert len(ups) == 2
    (row,) = client("list", path)["clients"]
    assert (row["state"], row["fingerprint"], row["next_fingerprint"]) == ("ok", begun["fingerprint"], "")
