"""A refusal that goes on is logged ever more rarely; one that is new is logged at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.long import long

from rsb_bridge.link.pending_connections import Refusals
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

_DAY = 24 * 3600.0
_TRIED_EVERY = 10.0


def test_a_refusal_that_goes_on(loop: VirtualLoop, context: Context) -> None:
    refusals = Refusals(context)

    def tries(seconds: float, message: str) -> int:
        """How many lines so many seconds of attempts cost."""
        before = context.events.last
        end = loop.time() + seconds
        while loop.time() < end:
            refusals.log("10.0.0.9", "a client", EventCode.LINK_WRONG_KEY, message, "robot1")
            for _ in range(int(_TRIED_EVERY)):
                loop.jump(1.0)
                refusals.tick()
        return context.events.last - before

    assert tries(_TRIED_EVERY, "the keys differ") == 1
    assert 3 <= tries(_DAY, "the keys differ") <= 32
    assert tries(_TRIED_EVERY, "another version") == 1
    for _ in range(120):  # it has given up
        loop.jump(1.0)
        refusals.tick()
    assert tries(_TRIED_EVERY, "the keys differ") == 1


@pytest.mark.parametrize("hosts", [["10.0.0.9"], *long([f"2001:db8::{number:x}" for number in range(1000)])])
def test_ever_new_words_from_one_host(hosts: list[str], loop: VirtualLoop, context: Context) -> None:
    """The stranger chooses the words; the log of 40 attempts a second stays small, and others' lines have
    room.
    """
    refusals = Refusals(context)
    for second in range(1200):
        for number in range(40):
            name = f"{second}.{number}"
            refusals.log(hosts[number % len(hosts)], "a client", EventCode.LINK_UNKNOWN_NAME, f"unknown: {name}", name)
        loop.jump(1.0)
        refusals.tick()
    assert context.events.last <= 20
    refusals.log("10.0.0.7", "a client", EventCode.LINK_WRONG_KEY, "the keys differ", "robot1")
    assert context.events.after(0)[-1].link == "robot1"


def test_a_log_line_from_many_hosts(loop: VirtualLoop, context: Context) -> None:
    refusals = Refusals(context)
    for second in range(600):
        for number in range(40):
            refusals.log(f"10.1.{second % 200}.{number}", "a client", EventCode.LINK_UNKNOWN_NAME, f"{second}", "")
        loop.jump(1.0)
        refusals.tick()
    assert context.events.last <= 256 + 600 * 0.5
