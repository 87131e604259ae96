"""The waits for an internal route on both sides, which end with what opens the route or ends it, in any order."""

from __future__ import annotations

import asyncio
import contextvars
from typing import TYPE_CHECKING, Any

import pytest
from tests.simulation.loop import PROGRAM

from rsb_bridge.link.internal_routes import OPENED_WITHIN, InternalRoutes
from rsb_bridge.model.purposes import purposes
from rsb_bridge.ros.internal_ends import BytesDrain, BytesSource

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.simulation.beds import Yard

    from rsb_bridge.model.session import Direction
    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.route.route import Route

pytestmark = pytest.mark.skipif("view" not in purposes(), reason="the core alone")
SOON = 0.001
PAUSED_FOR = 0.5
every_way = pytest.mark.parametrize(("viewer_is_server", "transport"), [(False, "tcp"), (True, "tcp"), (False, "udp")])


class InternalHalf:
    """One half of an internal route, and the wait until it is open."""

    def __init__(self, yard: Yard, internal: InternalRoutes[BytesSource, BytesDrain], route: Route) -> None:
        self.link = link = yard.link(on_server=not route.peer.is_client)
        self.route = route
        run = (yard.robot if link.is_client else yard.server).run
        assert run is not None
        self._program = contextvars.copy_context()  # which owns the sockets that it opens
        self._program.run(PROGRAM.set, run.process)
        self._end: Callable[[Route], Any] = internal.source if route.outgoing else internal.drain
        self.waiting = asyncio.create_task(internal.opened(route, route.id))

    @property
    def is_open(self) -> bool:
        return self.route.crossing.flows and self._end(self.route) is not None

    def pause(self, *, paused: bool) -> None:
        self._program.run(self.link.table.pause, self.route, paused=paused)

    def remove(self) -> None:
        self._program.run(self.link.table.remove, self.route, "over")

    def deny(self) -> None:
        self._program.run(self.link.table.deny, self.route, "no more")

    async def ends(self) -> bool:
        """Return what the wait has found; it ends with the event, and not at a look some time later."""
        while not (self.is_open or self.waiting.done()):  # noqa: ASYNC110 — plain state of a simulated world
            await asyncio.sleep(SOON)
        if self.is_open:
            await asyncio.sleep(SOON)
            assert self.waiting.done()
        return await self.waiting


class Opening:
    """A view's route that is being opened: its viewer's half takes pictures, and the other one sends them."""

    def __init__(self, yard: Yard, transport: Protocol = "tcp", *, viewer_is_server: bool = False) -> None:
        self._yard = yard
        self._purpose = purpose = purposes()["view"]
        self._links = [yard.link(on_server=on_server) for on_server in (viewer_is_server, not viewer_is_server)]
        self._internal = [InternalRoutes(each, each.table, purpose, BytesSource, BytesDrain) for each in self._links]
        direction: Direction = "transmit" if viewer_is_server else "receive"
        route = self._internal[0].open(
            purpose.route_name("1"), direction, depth=1, compression="none", transport=transport
        )
        self.viewer = InternalHalf(yard, self._internal[0], route)

    async def sender(self) -> InternalHalf:
        """Wait until the proposal has come, and return the half that it makes."""
        link = self._links[1]
        while not (found := [each for each in link.routes.values() if each.purpose is self._purpose]):  # noqa: ASYNC110 — as above
            await asyncio.sleep(SOON)
        return InternalHalf(self._yard, self._internal[1], found[0])


@every_way
async def test_waits_end_as_soon_as_route_is_open(viewer_is_server: bool, transport: Protocol, yard: Yard) -> None:
    opening = Opening(yard, transport, viewer_is_server=viewer_is_server)
    sender = await opening.sender()
    assert all(await asyncio.gather(opening.viewer.ends(), sender.ends()))


@every_way
@pytest.mark.parametrize("at", [0.0, 0.005, 0.02, 0.1])
@pytest.mark.parametrize("resumed_by_sender", [False, True])
async def test_pause_may_precede_or_follow_channel(
    at: float, resumed_by_sender: bool, viewer_is_server: bool, transport: Protocol, yard: Yard
) -> None:
    opening = Opening(yard, transport, viewer_is_server=viewer_is_server)
    viewer = opening.viewer
    await asyncio.sleep(at)
    was_open = viewer.is_open
    viewer.pause(paused=True)
    sender = await opening.sender()
    await asyncio.sleep(PAUSED_FOR)
    assert viewer.waiting.done() == was_open
    (sender if resumed_by_sender else viewer).pause(paused=False)
    assert all(await asyncio.gather(viewer.ends(), sender.ends()))


async def test_refusal_ends_both_waits(yard: Yard) -> None:
    opening = Opening(yard)
    opening.viewer.pause(paused=True)
    sender = await opening.sender()
    await asyncio.sleep(PAUSED_FOR)
    sender.deny()
    assert not any(await asyncio.gather(opening.viewer.ends(), sender.ends()))
    assert opening.viewer.route.life.refusal


async def test_removal_ends_both_waits(yard: Yard) -> None:
    opening = Opening(yard)
    opening.viewer.pause(paused=True)
    sender = await opening.sender()
    await asyncio.sleep(PAUSED_FOR)
    opening.viewer.remove()
    await asyncio.sleep(SOON)
    assert opening.viewer.waiting.done()
    assert not any(await asyncio.gather(opening.viewer.ends(), sender.ends()))


async def test_wait_for_a_paused_route_is_given_up(yard: Yard) -> None:
    viewer = Opening(yard).viewer
    viewer.pause(paused=True)
    await asyncio.sleep(OPENED_WITHIN - SOON)
    assert not viewer.waiting.done()
    await asyncio.sleep(2 * SOON)
    assert viewer.waiting.done()
    assert not await viewer.waiting
