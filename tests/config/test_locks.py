"""The lock files by which a robot is installed as it was tested (docs/install.md)."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.support.captured import captured

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = {
    "run": (),
    "fleet": ("zenoh", "metrics"),
    "ros": ("ros", "zenoh", "metrics", "look", "record"),
    "dev": ("ros", "ros-test", "zenoh", "metrics", "look", "record", "dev"),
}
BUILD = PROJECT["build-system"]["requires"]
NAMED = {
    "build": BUILD,
    "checks": PROJECT["dependency-groups"]["checks"],
    **{
        lock: [
            *PROJECT["project"]["dependencies"],
            *BUILD,
            *(line for extra in extras for line in PROJECT["project"]["optional-dependencies"][extra]),
        ]
        for lock, extras in EXTRAS.items()
    },
}
"""The requirements of pyproject.toml that each lock has to meet."""
_LINE = re.compile(r"(?P<name>[a-z0-9-]+)==(?P<version>\S+)( ; (?P<marker>.+))?")


def entries(lock: str) -> list[tuple[str, str, str, list[str]]]:
    text = (ROOT / "locks" / f"{lock}.txt").read_text(encoding="utf-8").replace(" \\\n", "\n")
    found: list[tuple[str, str, str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("    --hash="):
            found[-1][3].append(line.strip().removeprefix("--hash="))
        elif not line.startswith("#"):
            match = _LINE.fullmatch(line)
            assert match, line
            found.append((match["name"], match["version"], match["marker"] or "", []))
    return found


@pytest.mark.parametrize("lock", NAMED)
def test_lock_has_all_that_is_named_with_hashes(lock: str) -> None:
    """After a change of pyproject.toml, run `make lock`."""
    locked = entries(lock)
    assert all(hashes and all(re.fullmatch(r"sha256:[0-9a-f]{64}", each) for each in hashes) for *_, hashes in locked)
    for requirement in map(Requirement, NAMED[lock]):
        versions = [version for name, version, *_ in locked if name == canonicalize_name(requirement.name)]
        assert versions, f"{requirement.name} is not in locks/{lock}.txt"
        assert all(requirement.specifier.contains(version) for version in versions)


@pytest.mark.parametrize("lock", NAMED)
def test_a_lock_has_all_that_its_packages_need(lock: str) -> None:
    """By what is installed here: pip takes nothing that has no hash."""
    locked = {name for name, _, marker, _ in entries(lock) if not marker or Marker(marker).evaluate()}
    for name in locked:
        try:
            needs = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # of the build, or of ROS where that is the distribution's
        for need in map(Requirement, needs):
            if need.marker is None or need.marker.evaluate({"extra": ""}):
                assert canonicalize_name(need.name) in locked, f"{name} needs {need.name}"


@pytest.mark.long  # it leaves this machine, which `make test` does not
def test_pip_takes_the_lock_of_a_robot() -> None:
    """With the hashes of pip's own index, where that can be reached."""
    pip = [sys.executable, "-m", "pip", "--retries", "0", "--timeout", "10", "--disable-pip-version-check", "install"]
    dry = [*pip, "--dry-run", "--ignore-installed", "--no-deps", "--quiet", "--only-binary", ":all:"]
    name, version, *_ = entries("run")[0]
    reached = subprocess.run([*dry, f"{name}=={version}"], capture_output=True, timeout=120, check=False)
    if reached.returncode:
        pytest.skip("pip reaches no index")
    locked = ROOT / "locks" / "run.txt"
    run = captured(*dry, "--require-hashes", "--requirement", str(locked), timeout=300)
    assert run.returncode == 0, run.stderr
