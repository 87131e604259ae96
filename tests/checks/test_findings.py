"""Each script of findings/ pins what it installs, cleans up, and is listed. To run them takes the network."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "findings"
SCRIPTS = sorted(FOLDER.glob("*.sh"))
HEAD = "set -euo pipefail\nfolder=$(mktemp -d)\ntrap 'rm -rf \"$folder\"' EXIT\n"


def listed() -> dict[str, str]:
    """The packages that the README's table names, by script."""
    table = (FOLDER / "README.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^\| \[([\w-]+)\]\(\1\.sh\) \| ([^|]+) \|", table, re.MULTILINE))


def test_the_readme_lists_each_finding() -> None:
    assert [*listed()] == [path.stem for path in SCRIPTS]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_finding_can_be_run_alone(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert os.access(path, os.X_OK)
    assert HEAD in text
    assert "rsb_" not in text
    installed = [
        requirement.strip('"')
        for command in re.findall(r"pip install (.+?[^\\])\n", text, re.DOTALL)
        for requirement in command.replace("\\\n", " ").replace("--index-url https://pypi.org/simple", "").split()
        if not requirement.startswith("-")
    ]
    assert installed
    assert all(re.fullmatch(r"[\w-]+(\[[\w,-]+\])?==[\w.]+", each) for each in installed), installed
    versions = dict(re.sub(r"\[.+\]", "", each).replace("_", "-").split("==") for each in installed)
    for named in listed()[path.stem].split(", "):
        package, version = named.split()
        assert versions[package] == version


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_program_of_finding_can_be_read(path: Path) -> None:
    (program,) = re.findall(r"<<'PYTHON'\n(.+?)^PYTHON$", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    ast.parse(program)
