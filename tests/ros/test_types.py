"""Type names, and descriptions of installed types."""

from __future__ import annotations

import importlib
import subprocess
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.wording import pattern

from rsb_bridge.model.type_names import SHORT_NAMES, TypeNameProblem, expand_type_name
from rsb_bridge.ros.native.typesupport import hash_of, installed_class

if TYPE_CHECKING:
    from pathlib import Path

COMMON_INTERFACES = [
    "actionlib_msgs",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "sensor_msgs",
    "shape_msgs",
    "std_msgs",
    "stereo_msgs",
    "trajectory_msgs",
    "visualization_msgs",
]


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("LaserScan", "sensor_msgs/msg/LaserScan"),
        ("TFMessage", "tf2_msgs/msg/TFMessage"),
        ("nav_msgs/Odometry", "nav_msgs/msg/Odometry"),
        ("my_pkg/msg/Thing", "my_pkg/msg/Thing"),
        ("my_pkg/action/Go_FeedbackMessage", "my_pkg/action/Go_FeedbackMessage"),
    ],
)
def test_expands(name: str, full: str) -> None:
    assert expand_type_name(name) == full


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("LaserScann", TypeNameProblem.SHORT_NAME_MISSPELT),
        ("Xyzzy", TypeNameProblem.SHORT_NAME_UNKNOWN),
        ("a/b/c/d", TypeNameProblem.INVALID),
        ("Pkg/msg/Name", TypeNameProblem.INVALID),
        ("pkg/msgs/Name", TypeNameProblem.INVALID),
        ("", TypeNameProblem.SHORT_NAME_UNKNOWN),
    ],
)
def test_refuses_with_a_remedy(name: str, problem: TypeNameProblem) -> None:
    with pytest.raises(ValueError, match=pattern(problem, name=name)) as raised:
        expand_type_name(name)
    assert problem is not TypeNameProblem.SHORT_NAME_MISSPELT or "sensor_msgs/msg/LaserScan" in str(raised.value)


@pytest.mark.parametrize("package", COMMON_INTERFACES)
def test_short_names_are_those_of_the_installed_package(package: str) -> None:
    module = importlib.import_module(f"{package}.msg")
    installed = {f"{package}/msg/{name}" for name in vars(module) if name[0].isupper()}
    assert {full for full in SHORT_NAMES.values() if full.startswith(f"{package}/")} == installed


def test_hash_is_the_published_one() -> None:
    """The figure is what `ros2 topic info --verbose` shows for std_msgs/msg/String on any Jazzy."""
    string = installed_class("std_msgs/msg/String")
    assert string is not None
    assert hash_of(string) == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def test_python_package_without_rosidl_is_not_imported() -> None:
    assert installed_class("antigravity/msg/Name") is None
    assert "antigravity" not in sys.modules


def test_unknown_names_are_not_installed() -> None:
    assert installed_class("no_such_msgs/msg/Name") is None
    assert installed_class("std_msgs/msg/NoSuch") is None
    assert installed_class("std_msgs/srv/String") is None
    assert installed_class("std_srvs/msg/Trigger") is None  # a package without messages


def test_a_type_that_is_installed_later_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    replaced.LOOKS_FOR_TYPES.set(monkeypatch, SimpleNamespace(monotonic=lambda: now[0]))
    assert installed_class("later_msgs/msg/Name") is None
    folder = tmp_path / "later_msgs"
    (folder / "msg").mkdir(parents=True)
    (folder / "later_msgs_s__rosidl_typesupport_c.so").touch()
    (folder / "msg" / "__init__.py").write_text("class Name:\n    get_fields_and_field_types = None\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert installed_class("later_msgs/msg/Name") is None, "not for each topic that waits for it"
    now[0] = 20.0
    assert installed_class("later_msgs/msg/Name") is not None


def test_only_started_node_imports_rclpy() -> None:
    """The generator comes with a parser, which takes 5 MB; it can still be imported."""
    program = (
        "import sys, rsb_bridge.ros.ros_interface, rsb_bridge.ros.node\n"
        "assert 'rclpy' not in sys.modules\n"
        "from rsb_bridge.ros.native.typesupport import hash_of, installed_class\n"
        "assert hash_of(installed_class('std_msgs/msg/String'))\n"
        "assert 'lark' not in sys.modules\n"
        "import rosidl_generator_py.generate_py_impl; assert 'lark' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
