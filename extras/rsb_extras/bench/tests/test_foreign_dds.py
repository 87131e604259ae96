"""The bed of programs with other implementations of DDS in the developers' benchmarks."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import test_msgs.msg

ROOT = Path(__file__).parents[4]
PROGRAM = ROOT / "bench/peers/dds_programs/target/release/with_rustdds"


def ran(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the bed in a network of its own."""
    if shutil.which("ip") is None:
        pytest.skip("iproute2 is not installed")
    command = (sys.executable, "-m", "bench.foreign_dds", "--json", str(tmp_path / "found.json"), *arguments)
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    if "unshare:" in ended.stderr or "mount:" in ended.stderr:
        pytest.skip(f"no namespace of its own here: {ended.stderr}")
    return ended


@pytest.mark.skipif(PROGRAM.exists(), reason="`make peers` was run")
def test_bed_names_target_that_builds_programs(tmp_path: Path) -> None:
    ended = ran(tmp_path, "--parts", "rustdds")
    assert (ended.returncode, "make peers" in ended.stdout) == (0, True), ended.stderr


@pytest.mark.parametrize(
    "part",
    [
        "stock",
        pytest.param("rustdds", marks=pytest.mark.skipif(not PROGRAM.exists(), reason="not built: run `make peers`")),
    ],
)
def test_messages_cross_both_ways_from_either_end(tmp_path: Path, part: str) -> None:
    ended = ran(tmp_path, "--parts", part, "--cases", "reliable")
    assert ended.returncode == 0, ended.stderr
    runs = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))[part]["cases"]["reliable"]
    counts = [(way, end, run["heard"]) for way, ends in runs.items() for end, run in ends.items()]
    assert sorted(counts) == [(way, end, 20) for way in ("hears", "speaks") for end in ("desk", "direct", "robot")]


def test_parameters_cross_alone(tmp_path: Path) -> None:
    """Without a topic beside them."""
    ended = ran(tmp_path, "--parts", "stock", "--cases", "parameters", "--ends", "robot")
    assert ended.returncode == 0, ended.stderr
    runs = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["stock"]["cases"]["parameters"]
    assert [run["robot"]["heard"] for run in runs.values()] == [10, 10]


def test_types_with_key_are_left_out_with_a_sentence(tmp_path: Path) -> None:
    if hasattr(test_msgs.msg, "KeyedString"):
        pytest.skip("this distribution has a type with a key")
    ended = ran(tmp_path, "--parts", "stock", "--cases", "keyed", "--ends", "direct")
    assert (ended.returncode, "run this with Kilted's Python" in ended.stdout) == (0, True), ended.stderr
