"""Helpers of `test_arming` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


COMMANDS = Topic("/cmd", "receive", arm=True, deadman=0.0)


def is_set_up(*engines: Engine) -> bool:
    return all(route(engine, "/cmd").state == "disarmed" for engine in engines)


@pytest.fixture
def both_armed(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, consoles: Consoles) -> tuple[Engine, Engine]:
    robot.listener("/cmd")
    pc.publisher("/cmd")
    server, client = bridge.both(COMMANDS)
    eventually(lambda: is_set_up(server, client))
    consoles.arm(server)
    return server, client
