"""Hundreds of links on one server: what is done once a second for each of them leaves the loop to messages."""

from __future__ import annotations

import asyncio
import gc
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.offline import loop, make_context
from tests.support.waiting import eventually

from rsb_bridge.engine.bridge import Bridge
from rsb_bridge.model.purposes import TOPIC
from rsb_bridge.model.session import Client
from rsb_bridge.model.snapshot import Snapshot
from rsb_bridge.tasks import MOST_AT_ONCE
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher
from rsb_bridge.transport import descriptors

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["loop", "make_context"]

LINKS = 200
CLIENTS = tuple(Client(f"robot{number}") for number in range(LINKS))


class Turns:
    """Counts calls, in all and between two turns of the loop."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.calls = self.most_in_one_go = 0
        self._loop = loop
        self._in_one_go = 0

    def called(self) -> None:
        if not self._in_one_go:
            self._loop.call_soon(self._turn)
        self.calls += 1
        self._in_one_go += 1
        self.most_in_one_go = max(self.most_in_one_go, self._in_one_go)

    def _turn(self) -> None:
        self._in_one_go = 0


class Link:
    """A link with a few routes that notes each look at any of them."""

    only_counts = False

    def __init__(self, turns: Turns, routes: int) -> None:
        self.turns = turns
        self.routes: dict[str, Any] = {str(number): Route(turns) for number in range(routes)}
        self.resting: set[str] = set()

    @property
    def awake(self) -> list[Any]:
        return [route for key, route in self.routes.items() if key not in self.resting]

    @property
    def changes(self) -> int:
        return len(self.routes)

    def snapshot(self) -> Any:
        self.turns.called()


class Route:
    def __init__(self, turns: Turns) -> None:
        self.snapshot = turns.called
        self.shows_the_same = self.only_counts = False
        self.purpose = TOPIC


class Many:
    def __init__(self, links: list[Link]) -> None:
        self._links = links

    def links(self) -> list[Link]:
        return self._links

    unsaved = False

    def refused(self) -> tuple[()]:
        return ()


def test_links_tick_one_at_a_time(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context(name="control", role="server", clients=CLIENTS, use_encryption=False)
    bridge = Bridge(context, {client.name: () for client in CLIENTS}, publisher(context))
    turns = Turns(loop)
    for link in bridge.role.links():
        link.tick = turns.called  # type: ignore[method-assign]
    ticking = loop.create_task(bridge._tick())
    loop.run_until_complete(asyncio.sleep(1.5))
    assert not ticking.done()
    ticking.cancel()
    assert turns.calls == LINKS
    assert turns.most_in_one_go == 1


def test_a_command_about_one_route_renews_no_other(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    turns = Turns(loop)
    links = [Link(turns, routes=4) for _ in range(LINKS)]
    snapshots = publisher(make_context())
    snapshots.refresh_now(Many(links))
    before, shown = turns.calls, snapshots.latest
    snapshots.refresh_route(Many(links), links[1], links[1].routes["2"])
    assert turns.calls == before + 1
    assert snapshots.latest is not shown
    assert len(snapshots.latest.routes) == 4 * LINKS


def test_snapshot_of_many_links_is_made_in_slices(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Also the first one, in which each route is new."""
    turns = Turns(loop)

    links = [Link(turns, routes=4) for _ in range(LINKS)]

    shown = publisher(make_context())
    loop.run_until_complete(shown.refresh(Many(links)))
    assert (len(shown.latest.links), len(shown.latest.routes)) == (LINKS, 4 * LINKS)
    assert turns.calls == LINKS + 4 * LINKS
    assert turns.most_in_one_go <= 2 * MOST_AT_ONCE


def test_snapshot_has_links_present_at_its_end(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    turns = Turns(loop)
    links = [Link(turns, routes=1) for _ in range(LINKS)]

    class Changing:
        def links(self) -> list[Link]:
            return [*links]

        unsaved = False

        def refused(self) -> tuple[()]:
            return ()

    shown = publisher(make_context())

    async def main() -> None:
        refreshing = asyncio.ensure_future(shown.refresh(Changing()))
        await asyncio.sleep(0)
        assert not refreshing.done()
        del links[:50]
        links.append(Link(turns, routes=1))
        await refreshing

    loop.run_until_complete(main())
    assert len(shown.latest.links) == len(shown.latest.routes) == LINKS - 50
    loop.run_until_complete(shown.refresh(Changing()))
    assert len(shown.latest.links) == len(shown.latest.routes) == LINKS - 49


@pytest.mark.parametrize(
    ("looks", "least", "most"),
    [(0.0, 0, 0), (0.2, LINKS, LINKS), (1.0, 3 * LINKS, 5 * LINKS), (4.0, 4 * LINKS, 16 * LINKS)],
    ids=["nobody", "status line", "log", "console"],
)
def test_idle_routes_are_shown_anew_while_somebody_looks(
    looks: float, least: int, most: int, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    resting, awake = Turns(loop), Turns(loop)
    links = [Link(resting, routes=1) for _ in range(LINKS)]
    for link in links:
        link.resting.add("0")
        link.snapshot = lambda: None  # type: ignore[method-assign]
    links[0].routes["awake"] = Route(awake)

    shown = publisher(make_context())

    async def look() -> None:
        while looks:
            shown.newest()
            await asyncio.sleep(1 / looks)

    async def main() -> None:
        tasks = [asyncio.ensure_future(shown.run(Many(links))), asyncio.ensure_future(look())]
        await asyncio.sleep(4.9)
        resting.calls = awake.calls = 0
        await asyncio.sleep(4.0)
        for task in tasks:
            task.cancel()

    loop.run_until_complete(main())
    assert awake.calls >= 3
    assert least <= resting.calls <= most
    shown.newest()
    assert resting.calls >= least + LINKS or looks, "the first look in a while has all of the present"


def test_routes_that_show_the_same_are_shown_anew_after_an_event_or_when_the_clock_is_set(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    context, turns = make_context(), Turns(loop)
    (link,) = [Link(turns, routes=4)]
    link.snapshot = lambda: None  # type: ignore[method-assign]
    shown = publisher(context)
    shown.newest()

    def renewals() -> int:
        before = turns.calls
        shown.newest()
        loop.run_until_complete(shown.refresh(Many([link])))
        return turns.calls - before

    assert renewals() == 4
    for route in link.routes.values():
        route.shows_the_same = True
    assert (renewals(), renewals()) == (4, 0)
    link.routes["2"].shows_the_same = False
    assert renewals() == 1
    context.clock.epoch += 5.0  # type: ignore[attr-defined]
    assert renewals() == 4


def test_free_descriptors_are_known_without_listing_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stream of a route asks."""
    if not Path("/proc/self/fd").stat().st_size:
        return  # Linux before 6.2 gives no number
    replaced.LIST_DESCRIPTORS.set(monkeypatch, None)
    gc.collect()  # sockets of earlier tests

    def is_known() -> bool:
        """Look three times, between which Fast DDS may open or close a file."""
        before = descriptors.left()
        with ExitStack() as held:
            for _ in range(100):
                held.enter_context(socket.socket())
            meanwhile = descriptors.left()
        return (meanwhile, descriptors.left()) == (before - 100, before)

    eventually(is_known)


def publisher(context: Context) -> SnapshotPublisher:
    blank = Snapshot(0.0, "control", "server", "", 0, running=False)
    return SnapshotPublisher(blank, EventLog(context.clock), context.clock)


def test_while_nobody_looks_figures_alone_are_seldom_renewed(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    turns = Turns(loop)
    (link,) = [Link(turns, routes=20)]
    link.snapshot = lambda: None  # type: ignore[method-assign]
    shown = publisher(make_context())

    def renewals(seconds: int) -> int:
        before = turns.calls
        for _ in range(seconds):
            loop.run_until_complete(shown.refresh(Many([link])))
        return turns.calls - before

    assert renewals(1) == 20
    for route in link.routes.values():
        route.only_counts = True
    assert renewals(5) == 20, "each had its turn"
    link.routes["3"].only_counts = False
    assert renewals(5) == 20 + 4, "what may have changed has its turn each second"
    shown.newest()
    assert renewals(5) == 20 + 4, "a single look waits for a renewal of its own"
    shown.newest()
    assert renewals(1) == 20, "somebody goes on looking"


def test_while_nobody_looks_figures_of_links_are_seldom_renewed(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    turns = Turns(loop)
    links = [Link(turns, routes=0) for _ in range(10)]
    shown = publisher(make_context())

    def renewals(seconds: int) -> int:
        before = turns.calls
        for _ in range(seconds):
            loop.run_until_complete(shown.refresh(Many(links)))
        return turns.calls - before

    assert renewals(1) == 10
    for link in links:
        link.only_counts = True
    assert renewals(5) == 10, "each had its turn"
    links[3].only_counts = False
    assert renewals(5) == 10 + 4, "what may have changed has its turn each second"
    shown.newest()
    shown.newest()
    assert renewals(1) == 10, "somebody goes on looking"
