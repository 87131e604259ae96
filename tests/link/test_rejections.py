"""A refusal that goes on is logged ever more rarely; one that is new is logged at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from rsb_bridge.link.pending_connections import PendingConnections
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

_DAY = 24 * 3600.0
_TRIED_EVERY = 10.0


def test_a_refusal_that_goes_on(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context()
    pending = PendingConnections(context, cast("Any", None))
    stream = cast("Any", SimpleNamespace(host="10.0.0.9", peer="10.0.0.9:4242"))

    def tries(seconds: float, message: str) -> int:
        """How many lines so many seconds of attempts cost."""
        before = context.events.last
        end = loop.time() + seconds
        while loop.time() < end:
            pending.log_rejection(stream, EventCode.LINK_WRONG_KEY, message, "robot1")
            for _ in range(int(_TRIED_EVERY)):
                loop.jump(1.0)
                pending.tick()
        return context.events.last - before

    assert tries(_TRIED_EVERY, "the keys differ") == 1
    assert 3 <= tries(_DAY, "the keys differ") <= 32
    assert tries(_TRIED_EVERY, "another version") == 1
    for _ in range(120):  # it has given up
        loop.jump(1.0)
        pending.tick()
    assert tries(_TRIED_EVERY, "the keys differ") == 1
