"""`make test-pythons`: which Pythons it finds, and what it says of each run (`.ci/pythons.py`)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.support.captured import captured

PYTHONS = Path(__file__).parents[2] / ".ci/pythons.py"


class Machine:
    """Pythons and a make that are scripts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.printed: list[str] = []

    def has(self, path: str, script: str) -> str:
        program = self.folder / path
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        return str(program)

    def run(self, make: str) -> int:
        self.has("bin/make", f'echo "$@" >> made.txt\n{make}')
        environ = {"PATH": str(self.folder / "bin"), "PYENV_ROOT": str(self.folder / "pyenv")}
        ran = captured(sys.executable, "-P", PYTHONS, cwd=self.folder, env=environ, timeout=None)
        self.printed = ran.stdout.splitlines()
        return ran.returncode

    @property
    def made(self) -> list[str]:
        path = self.folder / "made.txt"
        return path.read_text().splitlines() if path.exists() else []

    def says(self, version: str) -> str:
        return next(line for line in self.printed if line.startswith(f"{version}: "))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_each_python_there_runs_once(machine: Machine) -> None:
    machine.has("bin/python3.11", "echo 3.11.2")
    machine.has("bin/python3.12", "exit 127")  # pyenv's, if none of this version is chosen
    machine.has("pyenv/versions/3.12.1/bin/python", "echo 3.12.1")
    newest = machine.has("pyenv/versions/3.12.10/bin/python", "echo 3.12.10")
    assert machine.run("exit 0") == 0
    assert machine.made == ["test VENV=.venv-3.11 PYTHON=python3.11", f"test VENV=.venv-3.12 PYTHON={newest}"]
    assert machine.says("3.12.10").split()[1] == "passed"
    assert [machine.says(each).split()[1] for each in ("3.13", "3.14")] == ["skipped,"] * 2


def test_one_red_python_is_red(machine: Machine) -> None:
    machine.has("bin/python3.11", "echo 3.11.2")
    machine.has("bin/python3.13", "echo 3.13.0")
    assert machine.run('case "$2" in *3.11) exit 2;; esac') == 1
    assert machine.says("3.11.2").split()[1] == "failed"
    assert machine.says("3.13.0").split()[1] == "passed"


def test_unstable_tests_of_all_are_kept(machine: Machine) -> None:
    machine.has("bin/python3.11", "echo 3.11.2")
    machine.has("bin/python3.13", "echo 3.13.0")
    (machine.folder / "build").mkdir()
    assert machine.run('echo "tests/test_a.py::test_$2" > build/unstable.txt') == 0
    names = [f"tests/test_a.py::test_VENV=.venv-{version}" for version in ("3.11", "3.13")]
    assert (machine.folder / "build/unstable.txt").read_text().split() == names
    assert machine.says("3.13.0").split()[1:4] == ["passed,", "unstable:", names[1]]


def test_no_python_is_red(machine: Machine) -> None:
    assert machine.run("exit 0") == 1
    assert machine.made == []
