"""The ingredients of a release and an image: commits, hashes and digests, and only the needed files of the checkout."""

from __future__ import annotations

import itertools
import re
import tomllib
from fnmatch import translate
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
import yaml
from tests.support.captured import captured

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def jobs(workflow: Path) -> dict[str, dict[str, Any]]:
    document: dict[str, Any] = yaml.safe_load(workflow.read_text(encoding="utf-8"))
    assert document["permissions"] == {}, "each job names its own"
    found: dict[str, dict[str, Any]] = document["jobs"]
    return found


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_are_named_by_their_commit(workflow: Path) -> None:
    used = re.findall(r"uses: (\S+)(.*)", workflow.read_text(encoding="utf-8"))
    assert used
    for action, comment in used:
        assert re.fullmatch(r"[\w-]+/[\w/-]+@[0-9a-f]{40}", action), action
        assert re.fullmatch(r" # v\d+\.\d+\.\d+", comment), f"{action}: name its version, for readers"


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_job_has_no_more_rights_than_it_names(workflow: Path) -> None:
    for name, job in jobs(workflow).items():
        assert job["permissions"], name
        steps = [step.get("uses", "").partition("@")[0] for step in job["steps"]]
        if "id-token" in job["permissions"] or job["permissions"].get("contents") == "write":
            assert "actions/checkout" not in steps, f"{name} runs code of the checkout with the rights of a release"


def test_containers_are_named_by_their_digest() -> None:
    images = [str(job["container"]["image"]) for path in WORKFLOWS for job in jobs(path).values() if "container" in job]
    stages = re.findall(r"^FROM (\S+)", (ROOT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    for image in [*images, *(stage for stage in stages if not stage.startswith("$"))]:
        assert re.fullmatch(r"[\w./-]+:[\w.-]+@sha256:[0-9a-f]{64}", image), image


@pytest.mark.parametrize("path", [".ci/release.sh", "Makefile", "Dockerfile", "deb/build.py"])
def test_a_build_installs_by_hash(path: str) -> None:
    """Only the files of the checkout have no hash; they come without their dependencies."""
    text = (ROOT / path).read_text(encoding="utf-8").replace("\\\n", " ")
    for line in re.findall(r".*(?:bin/pip install|\[\*into).*", text):
        for command in re.split(r"&&", line):
            assert "install" not in command or "--require-hashes" in command or "--no-deps" in command, command


@cache
def ignored() -> list[tuple[bool, re.Pattern[str]]]:
    """The lines of `.dockerignore`: whether each excludes, and what."""
    lines = [line for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if line[:1] not in "#"]
    found = []
    for line in lines:
        pattern = line.removeprefix("!")
        ways = {pattern, pattern.removeprefix("**/"), pattern.replace("**/", "*/")}
        found.append((line[0] != "!", re.compile("|".join(map(translate, sorted(ways))))))
    return found


def in_context(path: str) -> bool:
    """Whether Docker gets a file of the checkout: the last pattern that matches it, or a folder of it, decides."""
    above = [path, *map(str, PurePosixPath(path).parents)]
    excludes = [excluded for excluded, pattern in ignored() if any(map(pattern.match, above))]
    return not (excludes and excludes[-1])


@pytest.mark.parametrize(
    "path",
    [
        "session.yaml", "robot1.key", "key.txt", "session/session.yaml", "session/key.txt", "configs/mine.yaml",
        "configs/robot1.key", "bridge/rsb_bridge/robot1.key", "notes.txt", ".env", ".git/config", ".venv/bin/python",
        "bridge/rsb_bridge/__pycache__/api.pyc", "build/deb/x.deb",
    ],
)  # fmt: skip
def test_what_lies_in_checkout_stays_out_of_image(path: str) -> None:
    assert not in_context(path)


def test_image_gets_what_wheel_is_built_from() -> None:
    tracked = captured("git", "ls-files", cwd=ROOT, check=True).stdout.splitlines()
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    sources = [
        *wheel["packages"],
        *wheel["shared-data"],
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "hatch_build.py",
        "locks/fleet.txt",
    ]
    for source in sources:
        of_source = [path for path in tracked if path == source or path.startswith(f"{source}/")]
        assert of_source, source
        assert all(map(in_context, of_source)), source
    allowed = [path for path in tracked if in_context(path)]
    assert all(any(path == each or path.startswith(f"{each.split('/')[0]}/") for each in sources) for path in allowed)


def test_containers_session_is_in_folder_of_its_own() -> None:
    compose = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))
    mounts = itertools.chain.from_iterable(service.get("volumes", ()) for service in compose["services"].values())
    binds = [each for each in mounts if each.startswith(".")]
    assert binds == ["./session:/session:ro"]
    assert "/session/" in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()


def test_robostack_has_what_the_package_needs() -> None:
    """Nothing here reads `pixi.toml` but this test: pixi's own schema is on its site."""
    pixi = tomllib.loads((ROOT / "pixi.toml").read_text(encoding="utf-8"))
    assert set(pixi) == {"workspace", "dependencies", "pypi-dependencies", "tasks"}
    assert all(channel.startswith("https://prefix.dev/") for channel in pixi["workspace"]["channels"])
    extras = PROJECT["project"]["optional-dependencies"]
    assert set(extras["ros"]) <= set(pixi["dependencies"])
    assert set(pixi["pypi-dependencies"]["rsb-console"]["extras"]) <= set(extras)


def test_any_user_of_the_image_keeps_its_state() -> None:
    """Docker has / for the home of a user that the image does not know, as `RSB_USER` is."""
    compose, image = yaml.safe_load((ROOT / "compose.yaml").read_text()), (ROOT / "Dockerfile").read_text()
    home = re.search(r"^ENV .*HOME=(\S+)", image, re.MULTILINE)
    assert home is not None
    assert f"state:{home[1]}/.local/state" in compose["services"]["bridge"]["volumes"]
    assert f"install -d -m 1777 {home[1]}/.local/state" in image
    assert f"chmod 755 {home[1]} {home[1]}/.local" in image
