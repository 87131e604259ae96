"""A program with RustDDS, whose writers are reliable in name only, is heard as nodes are."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rclpy.qos import qos_profile_sensor_data
from tests.support.bridge import heard, route
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

_PROGRAM = Path(__file__).parents[1] / "support" / "rust_dds"
_BUILDS_WITHIN = 1200.0  # s: some 200 crates, once


@pytest.fixture(scope="module")
def talker(pytestconfig: pytest.Config) -> Path:
    """The program, which is built once."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed: a program with RustDDS cannot be built")
    assert pytestconfig.cache is not None
    target = pytestconfig.cache.mkdir("rust_dds")
    crates = ["--locked", "--manifest-path", str(_PROGRAM / "Cargo.toml")]
    fetched = subprocess.run(["cargo", "fetch", *crates], capture_output=True, text=True, check=False)
    if fetched.returncode:
        pytest.skip(f"cargo cannot fetch RustDDS: {fetched.stderr.strip().splitlines()[-1]}")
    subprocess.run(["cargo", "build", *crates, "--target-dir", target], check=True, timeout=_BUILDS_WITHIN)
    return target / "debug" / "rust-dds-talker"


@pytest.fixture
def talks(talker: Path, robot: Domain) -> Iterator[None]:
    with subprocess.Popen([talker, str(robot.id), "/numbers"]) as program:
        try:
            # Only a subscription that comes after the first message hears nothing.
            heard(robot.listener("/numbers", qos=qos_profile_sensor_data), 1)
            yield
        finally:
            program.kill()


@pytest.mark.usefixtures("talks")
def test_writer_that_repeats_nothing_is_heard(bridge: Bridge, pc: Domain) -> None:
    server, client = bridge.both(Topic("/numbers", "transmit"))
    heard(pc.listener("/numbers"), 5)
    eventually(lambda: (route(client, "/numbers").state, route(server, "/numbers").state) == ("ok", "ok"))
    (event,) = [each for each in client.events() if each.code == EventCode.ROUTE_UNRELIABLE]
    assert "repeats nothing" in event.text
