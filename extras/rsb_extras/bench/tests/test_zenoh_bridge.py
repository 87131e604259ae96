"""The bed of zenoh-bridge-ros2dds in the developers' benchmarks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
PROGRAM = ROOT / "bench/peers/zenoh_bridge/target/release/zenoh_bridge"
WITHOUT = """
from pathlib import Path
from bench import outages, quiet, robot, run, zenoh_bridge
zenoh_bridge.PROGRAM = Path("not built")
{}.main()
"""
SENDS = """
import sys
from bench import bed
near = int(sys.argv[1])
with bed.BEDS[sys.argv[2]](near, near + 1) as made:
    sent = made.send(100, 0.5, 1000)
    assert sent.received == sent.sent == 50
    assert min(sent.sides) > 0
"""


def ran(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = (sys.executable, "-c", code, *arguments)
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        ("quiet", ["table", "--peer"]),
        ("run", ["1", "--beds", "zenoh-bridge-tls"]),
        ("robot", ["--columns", "tcp,zenoh-bridge+tls"]),
        ("outages", ["--transports", "zenoh-bridge"]),
    ],
)
def test_bench_names_target_that_builds_peer(program: str, arguments: list[str]) -> None:
    ended = ran(WITHOUT.format(program), *arguments)
    assert (ended.returncode, "make peers" in ended.stderr) == (1, True)


@pytest.mark.skipif(not PROGRAM.exists(), reason="zenoh-bridge-ros2dds is not built: run `make peers`")
@pytest.mark.parametrize("kind", ["zenoh-bridge", "zenoh-bridge-tls"])
def test_peer_carries_messages_between_domains(spare_domains: int, kind: str) -> None:
    ended = ran(SENDS, str(spare_domains), kind)
    assert ended.returncode == 0, ended.stderr
