"""The modules of names that features may use, and what this project's own features use beyond them."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from rsb_bridge import feature_api
from rsb_console import feature_console

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import ModuleType

ROOT = Path(__file__).parents[2]
FEATURES = ROOT / "extras/rsb_extras"
APIS = [feature_api, feature_console]
BEYOND = {
    "audit": 19,
    "bench": 33,
    "courier": 9,
    "demo": 29,
    "disk_ring": 14,
    "doctor": 68,
    "driving": 55,
    "exporters": 24,
    "fleet": 69,
    "frames": 14,
    "history": 14,
    "imports": 39,
    "machine_state": 1,
    "mcp_server": 2,
    "mirrored_nodes": 6,
    "node_control": 4,
    "nodes": 13,
    "operators": 24,
    "own_commands": 7,
    "pictures": 41,
    "playing": 22,
    "recording": 18,
    "service": 1,
    "units": 3,
    "zenoh": 32,
}
"""How many names of the core each feature imports beyond these modules. A number may only fall: use what is there, or
add what a second feature needs, too."""


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the names that a module imports, each with the module that has it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, each.name) for each in node.names)


def beyond(feature: str) -> set[tuple[str, str]]:
    """Return what a feature imports of the core that is not in these modules; its tests and pictures may use any."""
    paths = [each for each in (FEATURES / feature).rglob("*.py") if not {"tests", "docs"} & {*each.parts}]
    own = ("rsb_bridge.", "rsb_console.")
    found = {each for path in paths for each in imported(path) if each[0].startswith(own)}
    return {each for each in found if each[0] not in {api.__name__ for api in APIS}}


@pytest.mark.parametrize("api", APIS, ids=lambda api: api.__name__)
def test_types_are_those_of_the_table(api: ModuleType) -> None:
    (block,) = (node for node in ast.parse(Path(str(api.__file__)).read_text()).body if isinstance(node, ast.If))
    shown = {node.module: {each.name for each in node.names} for node in block.body if isinstance(node, ast.ImportFrom)}
    assert shown == {home: set(names) for home, names in api._NAMES.items()}


@pytest.mark.parametrize("api", APIS, ids=lambda api: api.__name__)
def test_each_name_is_that_of_its_home(api: ModuleType) -> None:
    for home, names in api._NAMES.items():
        for name in names:
            assert getattr(api, name) is getattr(importlib.import_module(home), name)
    with pytest.raises(ImportError):
        exec(f"from {api.__name__} import Nonsense")


@pytest.mark.skipif(not FEATURES.is_dir(), reason="the core alone")
def test_features_use_less_and_less_beyond_them() -> None:
    folders = sorted(each.parent.name for each in FEATURES.glob("*/__init__.py"))
    assert {folder: len(beyond(folder)) for folder in folders} == BEYOND


@pytest.mark.skipif(not FEATURES.is_dir(), reason="the core alone")
def test_features_import_no_name_from_its_home_that_is_in_them() -> None:
    homes = {(home, name) for api in APIS for home, names in api._NAMES.items() for name in names}
    assert {folder.name: beyond(folder.name) & homes for folder in FEATURES.iterdir() if folder.is_dir()} == {
        folder.name: set() for folder in FEATURES.iterdir() if folder.is_dir()
    }


def test_they_import_nothing_until_a_name_is_used() -> None:
    program = (
        "import sys, rsb_bridge.feature_api, rsb_console.feature_console;"
        "print(*sorted(name for name in sys.modules if name.startswith(('rsb_', 'textual', 'rclpy'))))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=180, check=True)
    own = {"rsb_bridge", "rsb_bridge.feature", "rsb_bridge.feature_api", "rsb_console", "rsb_console.feature_console"}
    assert {*ran.stdout.split()} == own
