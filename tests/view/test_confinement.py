"""A message that takes over the process that draws finds no file, no network, no program and no rights."""

from __future__ import annotations

import io
import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import CompressedImage
from tests.support import constants
from tests.view.samples import task

from rsb_bridge.model.pictures import Wish

if TYPE_CHECKING:
    from rsb_bridge.view.renderer import Renderer

_TRIES = """
import json, os, socket, sys
from rsb_bridge.view.confinement import confine
held = confine()._asdict()
def refused(act):
    try:
        act()
    except PermissionError:
        return True
    except OSError as error:
        return str(error)
    return False
secret, written, port = sys.argv[1:]
print(json.dumps(held | {
    "reads": refused(lambda: open(secret)),
    "lists": refused(lambda: os.listdir(os.path.dirname(secret))),
    "writes": refused(lambda: open(written, "w")),
    "removes": refused(lambda: os.remove(secret)),
    "runs": refused(lambda: os.execv("/bin/true", ["true"])),
    "connects": refused(lambda: socket.create_connection(("127.0.0.1", int(port)))),
    "listens": refused(lambda: socket.create_server(("127.0.0.1", 0))),
    "imports": bool(__import__("zipfile")),
}))
"""


@pytest.fixture
def tried(tmp_path: Path) -> dict[str, Any]:
    """The requests that a confined process was refused."""
    secret = tmp_path / "robot1.key"
    secret.write_text("secret")
    with socket.create_server(("127.0.0.1", 0)) as server:
        arguments = (str(secret), str(tmp_path / "written"), str(server.getsockname()[1]))
        ran = subprocess.run(
            (sys.executable, "-P", "-c", _TRIES, *arguments), capture_output=True, text=True, check=True, timeout=60
        )
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def test_what_draws_reaches_nothing(tried: dict[str, Any]) -> None:
    assert tried["no_new_privileges"]
    assert tried["no_capabilities"]
    assert tried["imports"]
    if not tried["landlock"]:
        pytest.skip("this kernel has no Landlock")
    assert [tried[each] for each in ("reads", "lists", "writes", "removes", "runs")] == [True] * 5
    if tried["landlock"] >= 4:
        assert [tried[each] for each in ("connects", "listens")] == [True] * 2


async def test_the_drawing_process_is_confined_and_draws(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also what imports Pillow and numpy only then, which may take over 3 s at low priority."""
    constants.DRAWING_WITHIN.set(monkeypatch, 60.0)
    image = pytest.importorskip("PIL.Image")
    encoded = io.BytesIO()
    image.new("RGB", (8, 8), "red").save(encoded, "png")
    message = CompressedImage(format="png", data=encoded.getvalue())
    assert (await renderer.draw(task(Wish(how="tree"), Vector3(x=1.0), view=1))).problem == ""
    assert (await renderer.draw(task(Wish(), message, view=2))).problem == ""
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{renderer.pid}/status").read_text().splitlines())
    assert status["NoNewPrivs"] == "1"
    assert {int(status[each], 16) for each in ("CapEff", "CapPrm", "CapInh", "CapAmb")} == {0}
