"""Messages by hand for robots of a fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support import surroundings
from tests.support.fleet import ServerEngine

from rsb_bridge.model.audience import Audience
from rsb_extras.driving.publish_requests import Published
from rsb_extras.driving.tests.publishing_engine import PublishingEngine
from rsb_extras.fleet.tests.fleet_command_helpers import Fleet, fleet

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_extras.fleet.tests.fleet_command_helpers import Fleet

__all__ = ["fleet"]


class PublishingServer(PublishingEngine, ServerEngine):
    """A server of robots that takes messages by hand."""


@pytest.fixture
def engine(machine: Machine) -> PublishingServer:
    return machine.have(PublishingServer("robot1", "robot2"))


def test_a_rate_without_an_end_is_refused(engine: PublishingServer, fleet: Fleet) -> None:
    assert fleet("exec", "robot1", "--", "pub", "/cmd_vel", "", "--rate", "10").code == 2
    assert engine.commands == []


def test_each_robot_gets_what_standard_input_has(
    engine: PublishingServer, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only the first one, while the others get the defaults of every field."""
    engine.published = [Published(is_done=True, audience=Audience(1))] * 2
    surroundings.set_stdin(monkeypatch, "data: true")
    assert fleet("exec", "robot1", "robot2", "--", "pub", "/camera", "-").code == 0
    assert [each[1].fields for each in engine.commands if each[0] == "publish"] == ["data: true"] * 2  # type: ignore[attr-defined]
