"""kill -9 of either side in mid-call; `tests.calls.killing` does it more often."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.killing import Killing, kill

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.program import Programs


def test_no_answer_is_wrong_anothers_or_left_over(
    bridge: Bridge, programs: Programs, near: CallNode, far: CallNode, another: Callable[[int], CallNode], service: str
) -> None:
    tally = kill(Killing(bridge, programs, far, (near, another(bridge.robot.id)), service), 3)
    assert tally.grown.resident < 20 << 20
