"""The features of this tree: each is on its own, and a core without them says what it lacks."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from rsb_bridge.feature import BRINGS, BRINGS_ACTIONS, BRINGS_SETTINGS, BRINGS_TRANSPORTS
from rsb_bridge.installed_features import installed
from rsb_console.actions.all_actions import OF_CORE

ROOT = Path(__file__).parents[2]
FOLDERS = {each.parent.name: each.parent for each in ROOT.glob("extras/rsb_extras/*/__init__.py")}
WITHOUT = "import importlib.metadata\nimportlib.metadata.entry_points = lambda **_: ()\n"


def imported_features(folder: Path) -> set[str]:
    """Return the features whose modules a folder's code imports; its tests and its pages' pictures may use any."""
    trees = (ast.parse(path.read_text()) for path in folder.rglob("*.py") if {"tests", "docs"}.isdisjoint(path.parts))
    nodes = (node for tree in trees for node in ast.walk(tree))
    names = (node.module or "" for node in nodes if isinstance(node, ast.ImportFrom))
    return {name.split(".")[1] for name in names if name.startswith("rsb_extras.")}


@pytest.mark.parametrize("name", sorted(FOLDERS))
def test_feature_is_installed_by_its_folders_name(name: str) -> None:
    feature = importlib.import_module(f"rsb_extras.{name}").FEATURE
    assert feature.name == name
    assert feature in installed()


@pytest.mark.parametrize("name", sorted(FOLDERS))
def test_a_feature_imports_only_those_that_it_needs(name: str) -> None:
    feature = importlib.import_module(f"rsb_extras.{name}").FEATURE
    assert imported_features(FOLDERS[name]) <= {name, *feature.needs}


@pytest.mark.skipif(not FOLDERS, reason="the core alone")
def test_the_core_knows_which_feature_brings_which_key() -> None:
    found = {
        key.name: name
        for name in FOLDERS
        for key in importlib.import_module(f"rsb_extras.{name}").FEATURE.session_keys()
    }
    assert found == BRINGS


@pytest.mark.skipif(not FOLDERS, reason="the core alone")
def test_the_core_knows_which_feature_brings_which_action() -> None:
    features = (importlib.import_module(f"rsb_extras.{name}").FEATURE for name in FOLDERS)
    of_core = {action.id for action in OF_CORE}
    brought = {
        action.id: feature.name
        for feature in features
        for action in (*feature.actions(), *(each for actions in feature.screens() for each in actions))
        if action.id not in of_core
    }
    assert brought == BRINGS_ACTIONS


@pytest.mark.skipif(not FOLDERS, reason="the core alone")
def test_the_core_knows_which_feature_brings_which_setting() -> None:
    found = {
        setting.name: name
        for name in FOLDERS
        for setting in importlib.import_module(f"rsb_extras.{name}").FEATURE.console_settings()
    }
    assert found == BRINGS_SETTINGS


def test_action_of_missing_feature_names_it(tmp_path: Path) -> None:
    keys = tmp_path / "keys.yaml"
    keys.write_text("pause: P\ndrive: X\n")
    asked = WITHOUT + (
        "import pathlib\n"
        "from rsb_console.preferences import PreferenceError, load_keymap\n"
        f"try: load_keymap(pathlib.Path({str(keys)!r}))\n"
        "except PreferenceError as error: print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=180, check=True)
    assert ran.stdout == f"{keys}: this installation has no driving: install all of rsb-console, or leave drive out\n"


def test_setting_of_missing_feature_names_it(tmp_path: Path) -> None:
    (tmp_path / "console.yaml").write_text("commands: {Y: {run: uptime}}")
    asked = WITHOUT + (
        "import pathlib\n"
        "from rsb_console.preferences import Preferences\n"
        f"for _, problem in Preferences(pathlib.Path({str(tmp_path)!r}), None).problems: print(problem)\n"
    )
    ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=180, check=True)
    assert ran.stdout.startswith(f"{tmp_path / 'console.yaml'}: this installation has no own_commands: ")
    assert ran.stdout.count("\n") == 1


@pytest.mark.skipif(not FOLDERS, reason="the core alone")
def test_the_core_knows_which_feature_brings_which_transport() -> None:
    found = {
        traits.name: name
        for name in FOLDERS
        for traits in importlib.import_module(f"rsb_extras.{name}").FEATURE.transport_traits()
    }
    assert found == BRINGS_TRANSPORTS


@pytest.mark.parametrize(
    ("session", "key"),
    [
        ("dict(server_ip='zenoh')", "server_ip"),
        ("dict(server_ip='10.0.0.1', topics=[dict(topic='/a', direction='transmit', protocol='zenoh')])",
         "topics[0].protocol"),
    ],
)  # fmt: skip
def test_transport_of_missing_feature_names_it(session: str, key: str) -> None:
    asked = WITHOUT + (
        "from rsb_bridge.config.validation import build\n"
        "common = dict(name='a', role='client', server_port=7060, use_encryption=False)\n"
        f"for problem in build(common | {session})[1]: print(problem.location, problem.message)\n"
    )
    ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=180, check=True)
    assert ran.stdout.startswith(f"{key} ")
    assert "rsb-console[zenoh]" in ran.stdout
    assert ran.stdout.count("\n") == 1


def test_key_of_missing_feature_names_it() -> None:
    asked = WITHOUT + (
        "from rsb_bridge.config.validation import build\n"
        "session = dict(name='a', role='client', server_ip='10.0.0.1', server_port=7060, use_encryption=False)\n"
        "for problem in build(session | {'metrics': '127.0.0.1:9464'})[1]: print(problem)\n"
    )
    ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=180, check=True)
    assert ran.stdout.startswith("metrics: this installation has no exporters: ")
    assert ran.stdout.count("\n") == 1
