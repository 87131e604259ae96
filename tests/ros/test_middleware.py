"""An RMW_IMPLEMENTATION that is not installed: a clear error instead of rcl's exit code 102."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from tests.support import constants
from tests.support.captured import captured

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session
from rsb_bridge.ros.distribution import MiddlewareProblem, check_libraries, check_middleware, package_of
from rsb_bridge.ros.ros_interface import RosError

COMMAND = str(Path(sys.executable).with_name("rsb-console"))


def problem(variable: str) -> str:
    return MiddlewareProblem.NOT_INSTALLED(
        variable=variable,
        wanted="rmw_nonsense_cpp",
        installed="rmw_fastrtps_cpp",
        package=package_of("rmw_nonsense_cpp"),
    )


def test_the_program_names_a_middleware_that_is_missing(tmp_path: Path) -> None:
    write_key(tmp_path / "robot1.key")
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=49152, key_file="robot1.key")
    save(session, tmp_path / "robot1.yaml")
    run = captured(
        COMMAND,
        "run",
        str(tmp_path / "robot1.yaml"),
        "--no-ui",
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_nonsense_cpp"},
    )
    assert run.returncode == 1, run
    [line] = run.stderr.splitlines()
    assert problem("RMW_IMPLEMENTATION") in line
    assert run.stdout == ""


def test_so_does_the_middleware_that_rcl_demands() -> None:
    variable = "RCL_ASSERT_RMW_ID_MATCHES"
    with pytest.raises(RosError) as raised:
        check_middleware({**os.environ, variable: "rmw_nonsense_cpp"})
    assert problem(variable) in str(raised.value)


def test_the_index_of_every_installation_is_read(tmp_path: Path) -> None:
    for number, name in enumerate(("rmw_one_cpp", "rmw_other_cpp")):
        entry = tmp_path / str(number) / "share/ament_index/resource_index/rmw_typesupport" / name
        entry.parent.mkdir(parents=True)
        entry.touch()
    prefixes = f"{tmp_path / '0'}:{tmp_path / '1'}"
    for wanted in ("rmw_one_cpp", "rmw_other_cpp", ""):
        check_middleware({"AMENT_PREFIX_PATH": prefixes, "RMW_IMPLEMENTATION": wanted})
    with pytest.raises(RosError, match=r"installed: .*rmw_one_cpp, rmw_other_cpp"):
        check_middleware({"AMENT_PREFIX_PATH": prefixes, "RMW_IMPLEMENTATION": "rmw_implementation"})


def test_installation_without_index_is_left_to_rcl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    constants.ROS_PREFIX.set(monkeypatch, str(tmp_path))
    check_middleware({"RMW_IMPLEMENTATION": "rmw_nonsense_cpp"})


def test_program_started_by_another_environment_names_both(tmp_path: Path) -> None:
    """Its wheels' libraries would be loaded, as its variables are inherited."""
    theirs = tmp_path.resolve() / "kilted"
    inherited = {
        "LD_LIBRARY_PATH": str(theirs / "lib/python3.11/site-packages/ros_rclpy.libs"),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }
    if not any(Path(sys.prefix).glob("lib/python*/site-packages/ros_rclpy.libs")):
        pytest.skip("this Python's ROS does not come as wheels")
    write_key(tmp_path / "robot1.key")
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=49152, key_file="robot1.key")
    save(session, tmp_path / "robot1.yaml")
    run = captured(COMMAND, "run", str(tmp_path / "robot1.yaml"), "--no-ui", env={**os.environ, **inherited})
    assert run.returncode == 1, run
    [line] = run.stderr.splitlines()
    assert f"of {Path(sys.prefix).resolve()} would load the libraries of {theirs}," in line
    assert "env -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE" in line


def test_own_libraries_may_come_after_others(tmp_path: Path) -> None:
    ours, theirs = (tmp_path / name / "lib/python3.11/site-packages/ros_rclpy.libs" for name in ("ours", "theirs"))
    for each in ours, theirs:
        each.mkdir(parents=True)
    variables = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    check_libraries(variables | {"LD_LIBRARY_PATH": f"/usr/lib:{theirs}:{ours}"}, tmp_path / "ours")
    check_libraries({"LD_LIBRARY_PATH": str(theirs)}, tmp_path / "ours")
    check_libraries(variables | {"LD_LIBRARY_PATH": str(theirs)}, tmp_path / "a_setup_file")
    with pytest.raises(RosError, match=r"ours would load the libraries of .*theirs"):
        check_libraries(variables | {"LD_LIBRARY_PATH": str(theirs)}, tmp_path / "ours")


def test_libraries_of_linked_packages_are_own(tmp_path: Path) -> None:
    """As in the environment of ``make test-core``, and those of some package managers."""
    linked, real = (tmp_path / name / "lib/python3.11/site-packages" for name in ("linked", "real"))
    (real / "ros_rclpy.libs").mkdir(parents=True)
    linked.mkdir(parents=True)
    (linked / "ros_rclpy.libs").symlink_to(real / "ros_rclpy.libs")
    variables = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "LD_LIBRARY_PATH": str(real / "ros_rclpy.libs")}
    check_libraries(variables, tmp_path / "linked")
