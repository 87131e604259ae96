"""A program with RustDDS, whose writers are reliable in name only, is heard as nodes are."""

from __future__ import annotations

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

PROGRAM = Path(__file__).parents[2] / "bench/peers/dds_programs/target/release/rust_dds_talker"
pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason="not built: run `make peers`")


@pytest.fixture
def talks(robot: Domain) -> Iterator[None]:
    with subprocess.Popen([PROGRAM, str(robot.id), "/numbers"]) as program:
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
