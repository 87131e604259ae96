"""What is released: the same files from two builds, installed with hashes into bare environments, and used there."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_VERSIONS = ("3.11", "3.12", "3.13")


def _pythons() -> dict[str, str]:
    """The interpreters of this machine, by version; pyenv's are not on the PATH."""
    found = {}
    for version in _VERSIONS:
        pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
        if here := shutil.which(f"python{version}", path=os.defpath) or next(map(str, pyenv), None):
            found[version] = here
    if not found:
        found[".".join(map(str, sys.version_info[:2]))] = sys.executable
    return found


def _run(*command: str | Path, check: bool = True, **how: object) -> subprocess.CompletedProcess[str]:
    environ = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LD_", "_ROS"))}
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        command, check=check, **{"env": environ, "capture_output": True, "text": True, "timeout": 600, **how}
    )


def _hashes(folder: Path) -> dict[str, str]:
    return {each.name: hashlib.sha256(each.read_bytes()).hexdigest() for each in (folder / "dist").iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone of the commit with its distribution files."""
    folder = tmp_path_factory.mktemp("first") / "clone"
    _run("git", "clone", "--quiet", ROOT, folder)
    _run("make", "dist", cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (found,) = (built / "dist").glob("*.whl")
    return found


def test_two_builds_are_the_same(built: Path, tmp_path: Path) -> None:
    again = tmp_path / "elsewhere/and/deeper"
    again.parent.mkdir(parents=True)
    _run("git", "clone", "--quiet", ROOT, again)
    for each in again.rglob("*"):
        os.utime(each, (10**9, 10**9), follow_symlinks=False)
    _run("make", "dist", cwd=again, preexec_fn=lambda: os.umask(0o077))
    assert _hashes(again) == _hashes(built)
    assert len(_hashes(built)) == 2


def test_the_wheel_has_what_is_documented(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for ending in (
        "man/man1/rsb-console.1",
        "configs/robot1.yaml",
        "configs/grafana-dashboard.json",
        "rsb_console/launch/bridge.launch.py",
        "rsb_bridge/ros/fast_dds_histories.xml",
        "rsb_bridge/py.typed",
        "fish/vendor_completions.d/rsb-console.fish",
    ):
        assert any(name.endswith(ending) for name in names), ending
    assert not [name for name in names if "tests" in name or name.endswith((".pyc", ".key"))]


@pytest.mark.parametrize(("version", "python"), _pythons().items())
def test_it_runs_in_a_bare_environment(version: str, python: str, wheel: Path, tmp_path: Path) -> None:
    """Only what the lock file names, with hashes, and no ROS."""
    _run(python, "-m", "venv", tmp_path / "bare")
    pip = (tmp_path / "bare/bin/pip", "install", "--quiet", "--disable-pip-version-check")
    _run(*pip, "--require-hashes", "-r", ROOT / "locks/run.txt")
    locked = tmp_path / "wheel.txt"
    locked.write_text(f"{wheel} --hash=sha256:{hashlib.sha256(wheel.read_bytes()).hexdigest()}\n")
    _run(*pip, "--no-deps", "--require-hashes", "-r", locked)
    program = tmp_path / "bare/bin/rsb-console"
    assert _run(program, "--version").stdout.startswith("rsb-console ")
    shutil.copy(ROOT / "configs/robot1.yaml", tmp_path)
    _run(program, "keygen", tmp_path / "robot1.key")
    assert _run(program, "check", tmp_path / "robot1.yaml", check=False).returncode == 0
    ran = _run(program, "doctor", "--json", check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    findings = {each["code"]: each for each in json.loads(ran.stdout)["findings"]}
    assert findings["program"]["facts"]["python"].startswith(version)
    assert (findings["ros"]["grade"], bool(findings["ros"]["remedy"])) == ("error", True)
    ran = _run(program, "demo", "--no-ui", check=False)
    assert ran.returncode == 1
    assert "rsb-console[ros]" in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize(
    ("schema", "pattern"),
    [
        ("vendor.github-workflows", ".github/workflows/*.yml"),
        ("vendor.github-issue-forms", ".github/ISSUE_TEMPLATE/[!c]*.yml"),
        ("vendor.github-issue-config", ".github/ISSUE_TEMPLATE/config.yml"),
        ("vendor.dependabot", ".github/dependabot.yml"),
        ("vendor.compose-spec", "compose.yaml"),
    ],
)
def test_files_for_others_fit_their_schemas(schema: str, pattern: str) -> None:
    files = [str(each) for each in ROOT.glob(pattern)]
    assert files
    _run(sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *files)
