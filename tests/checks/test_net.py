"""The net under `make test`: what fails runs once more, alone (`.ci/net.py`)."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from tests.support.captured import captured

ROOT = Path(__file__).parents[2]
NET = ROOT / ".ci/net.py"
PASSES = "def test_passes():\n    pass\n"
FAILS = "def test_fails():\n    assert False\n"
SECOND_TIME = """
from pathlib import Path

def test_second_time{number}():
    count = Path("count{number}")
    count.write_text(count.read_text() + "x" if count.exists() else "x")
    assert len(count.read_text()) == 2
"""
"""A test that passes when it runs for the second time."""


class Net:
    """Runs tests in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "pytest.ini").touch()
        self.printed = ""

    def __call__(self, *arguments: str, **files: str) -> int:
        for name, content in files.items():
            (self.folder / f"test_{name}.py").write_text(content)
        environ = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
        environ |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT)}  # plugins take most of the time
        pytest_run = sys.executable, "-m", "pytest", "-q", "-p", "xdist", *arguments
        ran = captured(sys.executable, NET, *pytest_run, cwd=self.folder, env=environ, timeout=None)
        self.printed = ran.stdout
        return ran.returncode

    def said(self, begin: str) -> list[str]:
        """Return the tests in the line that begins so, or nothing without one."""
        return next((line.split()[1:] for line in self.printed.splitlines() if line.startswith(begin)), [])

    @property
    def unstable(self) -> list[str]:
        path = self.folder / "build/unstable.txt"
        return path.read_text().splitlines() if path.exists() else []

    def runs(self, number: int) -> int:
        return len((self.folder / f"count{number}").read_text())


@pytest.fixture
def net(tmp_path: Path) -> Net:
    return Net(tmp_path)


@pytest.mark.parametrize("workers", ["0", "2"])
def test_second_pass_is_green_and_named(net: Net, workers: str) -> None:
    assert net("-n", workers, a=SECOND_TIME.format(number=0), b=PASSES) == 0
    assert net.unstable == net.said("unstable:") == ["test_a.py::test_second_time0"]


def test_two_failures_are_red(net: Net) -> None:
    assert net(a=SECOND_TIME.format(number=0), b=FAILS) == 1
    assert net.said("failed twice:")[-1:] == ["test_b.py::test_fails"]
    assert net.unstable == []


@pytest.mark.parametrize(("count", "code", "runs"), [(3, 0, 2), (4, 1, 1)])
def test_more_than_three_are_red(net: Net, count: int, code: int, runs: int) -> None:
    files = {f"n{number}": SECOND_TIME.format(number=number) for number in range(count)}
    assert net(**files) == code
    assert [net.runs(number) for number in range(count)] == [runs] * count
    assert len(net.unstable) == (count if code == 0 else 0)


@pytest.mark.parametrize(
    ("trouble", "code"),
    [
        ("import nothing_of_this_name\n", 2),
        ("def test_interrupted():\n    raise KeyboardInterrupt\n", 2),
        ("import os\n\ndef test_ends():\n    os._exit(9)\n", 9),
    ],
    ids=["unreadable", "interrupted", "ended"],
)
def test_what_is_no_tests_failure_is_red(net: Net, trouble: str, code: int) -> None:
    """With a test beside that would be unstable: it is not run again."""
    assert net(a=SECOND_TIME.format(number=0), b=trouble) == code
    assert net.unstable == []


LANES = ("-n", "2", "--dist", "loadscope", "--max-worker-restart", "0", "-p", "tests.support.lost_workers")
ENDS = "import os\n" + SECOND_TIME.replace("assert", "len(count.read_text()) == 2 or os._exit(9) #")
"""A test that ends its process when it runs for the first time."""
ONCE = SECOND_TIME.replace("second_time", "once").replace("== 2", "== 1")
"""A test that fails when it runs again."""


def test_rest_is_run_after_a_lost_worker(net: Net) -> None:
    """What its lane had left, too; what has passed is not run again."""
    assert net(*LANES, a=ENDS.format(number=0) + ONCE.format(number=1), b=ONCE.format(number=2)) == 0
    assert net.unstable == net.said("unstable:") == ["test_a.py::test_second_time0"]
    assert (net.runs(0), net.runs(1), net.runs(2)) == (2, 1, 1)


def test_interrupt_beside_a_lost_worker_ends_all(net: Net) -> None:
    interrupts = "import time\n\ndef test_interrupted():\n    time.sleep(1)\n    raise KeyboardInterrupt\n"
    assert net(*LANES, a=ENDS.format(number=0), b=interrupts) == 2
    assert net.runs(0) == 1


def test_two_lost_workers_are_red(net: Net) -> None:
    """Though each would pass the next time."""
    assert net(*LANES, a=ENDS.format(number=0), b=PASSES) == 0
    assert net(*LANES, a=ENDS.format(number=1).replace("== 2", "== 3"), b=PASSES) == 20
    assert net.said("failed twice:")[-1:] == ["test_a.py::test_second_time1"]
    assert net.unstable == []


def test_failure_beside_a_lost_worker_is_red(net: Net) -> None:
    assert net(*LANES, a=ENDS.format(number=0), b=FAILS) == 1
    assert net.said("failed twice:")[-1:] == ["test_b.py::test_fails"]


def test_nothing_to_run_is_red(net: Net) -> None:
    assert net(a="") == 5


def test_earlier_failures_are_forgotten(net: Net) -> None:
    assert net(a=FAILS) == 1
    (net.folder / "test_a.py").unlink()
    assert net(b=SECOND_TIME.format(number=0)) == 0
    assert net.unstable == ["test_b.py::test_second_time0"]
    assert net(b=PASSES) == 0
    assert net.unstable == []
