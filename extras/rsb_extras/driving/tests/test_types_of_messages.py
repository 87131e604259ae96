"""The type of a message by hand is loaded outside of the I/O thread."""

from __future__ import annotations

import asyncio
import contextlib
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from tests.link.loading_types_helpers import TWIST, Loads, ros

from rsb_bridge.link.extension import LinkError
from rsb_bridge.ros.ros_interface import RosError
from rsb_extras.driving.publish_requests import DraftMessage
from rsb_extras.driving.publishing import Publishing

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["ros"]


def test_before_a_message_by_hand(loop: VirtualLoop, ros: Loads, make_context: Callable[..., Context]) -> None:
    bridge = SimpleNamespace(context=make_context(ros=ros), role=SimpleNamespace(links=list))
    publishing = Publishing(cast("Any", bridge))
    with contextlib.suppress(LinkError, RosError, asyncio.CancelledError):
        loop.run_until_complete(publishing.draft(DraftMessage("/cmd_vel", "Twist")))
    assert ros.loaded == [(TWIST, False)]
