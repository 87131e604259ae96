"""A link that an operator of the server has shut down for hours."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest
from tests.simulation.conditions import STILL
from tests.simulation.episodes import shut_down_for
from tests.simulation.world import World
from tests.support.long import long

from rsb_bridge.link.link import Link
from rsb_bridge.link.server_end import ServerEnd
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
    from rsb_bridge.transport.streams import Stream

_SHUT_DOWN = 3600.0
_PLAYED = _SHUT_DOWN + 300.0


@pytest.mark.parametrize("cuts", [2, *long(0)])
def test_client_shut_down_for_hours_comes_back(cuts: int) -> None:
    """Nobody walks to the robot: its engine stays up, also where the network fails meanwhile."""
    world = World(1, replace(STILL, topics=(1,)))
    asked: list[float] = []
    shown: set[str] = set()
    up_at: list[float] = []
    ask, tick = ServerEnd.asked, ServerEnd.tick

    def note_question(self: ServerEnd, stream: Stream) -> None:
        asked.append(world.loop.time())
        ask(self, stream)

    def note_state(self: ServerEnd) -> None:
        tick(self)
        if 60.0 + 2 * 36.0 < world.loop.time() < 60.0 + _SHUT_DOWN:
            assert not self.link.linked
            client = world.robots[0].host.run
            assert client is not None
            shown.update(str(link.snapshot().cause) for link in (self.link, *client.links()))
            assert not client.links()[0].end.shut_down  # `run --no-ui` would end

    up = Link.up

    def note_link(self: Link, *args: object) -> object:
        up_at.append(world.loop.time())
        return up(self, *args)  # type: ignore[arg-type]

    with (
        patch.object(ServerEnd, "asked", note_question),
        patch.object(ServerEnd, "tick", note_state),
        patch.object(Link, "up", note_link),
    ):
        world.play(_PLAYED, shut_down_for(world, _SHUT_DOWN, cuts=cuts))
    gaps = [later - earlier for earlier, later in itertools.pairwise(asked)]
    assert len(asked) > _SHUT_DOWN / 36.0 - 10 * cuts
    assert min(gaps) > 23.0 or cuts  # a network that comes back is tried at once
    assert max(gaps) < (140.0 if cuts else 37.0)
    cut_off = {LinkCause.UNREACHABLE, LinkCause.TIMED_OUT, LinkCause.NO_ANSWER}
    assert shown <= {LinkCause.SHUT_DOWN, *cut_off}
    assert bool(shown & cut_off) == bool(cuts)
    back = [at for at in up_at if at > 60.0 + _SHUT_DOWN]
    assert back
    assert min(back) < 60.0 + _SHUT_DOWN + 37.0
