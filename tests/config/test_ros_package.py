"""The ROS package: `ros2 run` and `ros2 launch` find it where the wheel is installed, and run the command."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from tests.support.captured import captured

from rsb_console.command.arguments import parser_and_commands

_ROOT = Path(__file__).parents[2]
_PACKAGE = _ROOT / "ros"
_PROJECT: dict[str, Any] = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))
_COMMAND = '#!/bin/sh\necho {} "$@"\nexit 7\n'


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """Return the folder for files that an installed wheel has outside Python's own folders."""
    made = tmp_path / "prefix"
    data = _PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
    for source, target in data.items():
        path = _ROOT / source
        (made / target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(path, made / target, dirs_exist_ok=True) if path.is_dir() else shutil.copy(path, made / target)
    return made


def command_in(folder: Path, says: str) -> None:
    folder.mkdir(parents=True)
    (folder / "rsb-console").write_text(_COMMAND.format(says))
    (folder / "rsb-console").chmod(0o755)


def test_the_ament_index_finds_it(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    index = pytest.importorskip("ament_index_python.packages")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    assert index.get_package_prefix("rsb_console") == str(prefix)
    share = Path(index.get_package_share_directory("rsb_console"))
    assert (share / "launch" / "bridge.launch.py").is_file()
    assert (share / "package.xml").is_file()


def test_rosdep_knows_all_that_the_package_needs() -> None:
    """The keys are packages of ROS itself, which jazzy/distribution.yaml of ros/rosdistro lists."""
    package = ET.parse(_PACKAGE / "package.xml").getroot()
    needed = {each.text for each in package if each.tag.endswith("depend")}
    launch_file = (_PACKAGE / "launch" / "bridge.launch.py").read_text()
    imported = set(re.findall(r"^(?:from|import) (\w+)", launch_file, re.MULTILINE)) - {"__future__", "pathlib"}
    assert needed == imported | {"rclpy", "ros2launch", "ros2run"}
    assert imported == {"ament_index_python", "launch"}


@pytest.mark.parametrize(("own", "expected"), [(True, "own"), (False, "on PATH")])
def test_ros2_run_prefers_command_of_prefix(own: bool, expected: str, prefix: Path, tmp_path: Path) -> None:
    command_in(tmp_path / "path", "on PATH")
    if own:
        command_in(prefix / "bin", "own")
    run = captured(
        prefix / "lib" / "rsb_console" / "rsb-console",
        "check",
        "a b",
        env={"PATH": f"{tmp_path / 'path'}:{os.defpath}"},
    )
    assert (run.returncode, run.stdout) == (7, f"{expected} check a b\n"), run.stderr


def test_without_any_command_it_says_what_to_install(prefix: Path) -> None:
    run = captured(prefix / "lib" / "rsb_console" / "rsb-console", env={"PATH": os.defpath})
    assert run.returncode == 127
    assert "pipx install" in run.stderr


def test_the_launch_file_uses_options_that_there_are() -> None:
    text = (_PACKAGE / "launch" / "bridge.launch.py").read_text()
    options = re.findall(r'"(--[a-z-]+)"', text)
    assert "--no-ui" in options
    values = {"--log-format": ["json"], "--status-every": ["5"], "--control": ["/tmp/s"]}
    line = [word for option in options for word in (option, *values.get(option, ()))]
    assert parser_and_commands()[0].parse_args(["run", "robot1.yaml", *line]).no_ui


def test_the_launch_file_starts_the_command(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    launch = pytest.importorskip("launch")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    spec = importlib.util.spec_from_file_location("bridge_launch", _PACKAGE / "launch" / "bridge.launch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = launch.LaunchContext()
    given = {"session": "~/robot1.yaml", "log_format": "json", "control": "/tmp/s", "respawn": "true"}
    context.launch_configurations.update(given)
    entities = module.generate_launch_description().entities
    for declared in entities[:-1]:
        declared.execute(context)
    (process,) = entities[-1].execute(context)
    command = ["".join(part.perform(context) for part in word) for word in process.cmd]
    assert command[0] == str(prefix / "lib" / "rsb_console" / "rsb-console")
    arguments = parser_and_commands()[0].parse_args(command[1:])
    assert arguments.session == Path("~/robot1.yaml").expanduser()
    assert (arguments.log_format, arguments.control, arguments.no_ui) == ("json", Path("/tmp/s"), True)
