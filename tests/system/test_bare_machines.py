"""Machines that lack what most have: a network, room in shared memory, a locale of UTF-8."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.wording import says

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Session
from rsb_bridge.ros.distribution import MemoryProblem
from rsb_bridge.transport.network_news import NameText

_COMMAND = Path(sys.executable).with_name("rsb-console")
_NODE = """
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.ros_interface import RosError
try:
    RosNode(55, "robot1").start()
except RosError as error:
    print(error)
"""


def apart(kind: str, script: str, *arguments: str) -> subprocess.Popen[str]:
    """Run a script of the shell in a namespace of its own."""
    command = ["unshare", "--user", "--map-root-user", f"--{kind}", "sh", "-c", script, "sh", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def skip_without(output: str) -> None:
    if "unshare:" in output or "mount:" in output:
        pytest.skip(f"no namespace of its own here: {output}")


@pytest.mark.parametrize("free", [0, 4096])
def test_full_shared_memory_is_named(free: int) -> None:
    """The libraries of ROS would end the process with SIGBUS while they are loaded."""
    fill = f'mount -t tmpfs -o size=64k none /dev/shm && head -c {65536 - free} /dev/zero > /dev/shm/full && exec "$@"'
    with apart("mount", fill, sys.executable, "-c", _NODE) as run:
        output, _ = run.communicate(timeout=120)
    skip_without(output)
    assert (run.returncode, says(output, MemoryProblem.SHARED_FULL, folder="/dev/shm", free=free // 1024)) == (0, True)


def test_missing_network_is_named(tmp_path: Path) -> None:
    """A name that is not looked up is no reason to correct it while there is only lo."""
    write_key(tmp_path / "robot1.key")
    session = Session(name="robot1", role="client", server_ip="pc.example", server_port=5000, key_file="robot1.key")
    save(session, tmp_path / "robot1.yaml")
    command = (str(_COMMAND), "run", "--no-ui", "--log-format", "json", str(tmp_path / "robot1.yaml"))
    with apart("net", 'ip link set lo up && exec "$@"', *command) as run:
        assert run.stdout is not None
        line = next((line for line in run.stdout if EventCode.LINK_UNREACHABLE in line or "unshare:" in line), "")
        run.terminate()
    skip_without(line)
    assert says(line, NameText.NO_NETWORK)


def test_umlaut_in_path_under_ascii_locale(tmp_path: Path) -> None:
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=5000, key_file="schlüssel.key")
    (tmp_path / "größe").mkdir()
    path = tmp_path / "größe" / "rob.yaml"
    save(session, path)
    write_key(path.with_name("schlüssel.key"))
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    run = subprocess.run(
        [_COMMAND, "check", path], capture_output=True, env=os.environ | ascii_only, timeout=120, check=False
    )
    assert (run.returncode, run.stderr, "schlüssel.key, for robot1" in run.stdout.decode()) == (0, b"", True)


def test_program_begins_once_more_at_most_under_ascii_locale() -> None:
    """``-X utf8=0`` counts for more than the variable with which it begins again."""
    ascii_only = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-X", "utf8=0", "-P", "-m", "rsb_console", "--version"]
    run = subprocess.run(command, capture_output=True, env=os.environ | ascii_only, timeout=120, check=False)
    assert (run.returncode, run.stdout.startswith(b"rsb-console ")) == (0, True)
