"""Message types are imported on another thread, so that no import ends a lease."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from tests.link.arming_helpers import propose, route
from tests.link.loading_types_helpers import TWIST, Loads, ros
from tests.link.route_table_helpers import hear_all, pair_of

from rsb_bridge.engine.topic_commands import ArmingCommands
from rsb_bridge.model.commands import ArmTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.route.arming import ArmingPhase

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["ros"]


def test_before_a_topic_is_armed(loop: VirtualLoop, ros: Loads, make_context: Callable[..., Context]) -> None:
    robot, pc = pair_of(make_context(), make_context(ros=ros, role="server"))
    propose(robot, Topic("/cmd_vel", "receive", arm=True, type="Twist"))
    hear_all((robot, pc))
    assert (TWIST, False) in ros.loaded, "when the route opens, as the other side may arm it"
    ros.loaded.clear()

    async def end_motions(_: set[str]) -> None: ...

    role = SimpleNamespace(links=lambda: [pc])
    bridge = SimpleNamespace(role=role, find=lambda key: (pc, pc.routes[key]), end_motions=end_motions)
    arming = ArmingCommands(cast("Any", bridge))
    armed = loop.create_task(arming.arm(ArmTopic(route(pc).key)))
    loop.run_until_complete(asyncio.sleep(0.01))
    assert ros.loaded == [(TWIST, False)]
    assert route(pc).arming.phase is ArmingPhase.ASKED
    armed.cancel()
