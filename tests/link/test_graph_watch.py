"""Routes look at the ROS graph when it changes, and neither too often nor all in one go."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.link.graph_watch import GraphWatch
from rsb_bridge.route.topic_subscription import KeyedRoutes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


class Links:
    """One link, and routes that note when they look.

    Attributes:
        looks: when (s) each look at all routes began.
        most_in_one_go: looks of single routes between two turns of the loop.
    """

    def __init__(self, loop: VirtualLoop, routes: int, cost: float = 0.0) -> None:
        self.routes = {str(number): Route(self, number) for number in range(routes)}
        self.looks: list[float] = []
        self.most_in_one_go = 0
        self._loop = loop
        self._cost = cost
        self._in_one_go = 0

    def __call__(self) -> Any:
        return [self]

    def guarded(self, work: Callable[[], None]) -> None:
        work()

    def looked(self, number: int) -> None:
        if number == 0:
            self.looks.append(self._loop.time())
        if not self._in_one_go:
            self._loop.call_soon(self._turn)
        self._in_one_go += 1
        self._loop.jump(self._cost)

    def _turn(self) -> None:
        self.most_in_one_go = max(self.most_in_one_go, self._in_one_go)
        self._in_one_go = 0


class Route:
    idle = False

    def __init__(self, links: Links, number: int) -> None:
        self.id = number + 1
        self._links = links
        self._number = number

    def advance(self) -> None:
        self._links.looked(self._number)


@pytest.fixture
def context(make_context: Callable[..., Context]) -> Context:
    return make_context()


@pytest.fixture
def watch(
    loop: VirtualLoop, context: Context
) -> Iterator[Callable[[Links], tuple[GraphWatch, Callable[[float], None]]]]:
    """Starts a watch; gives it, and what lets time pass."""
    tasks = []

    def start(links: Links) -> tuple[GraphWatch, Callable[[float], None]]:
        made = GraphWatch(context, links, lambda: None)
        tasks.append(loop.create_task(made.run()))
        return made, lambda seconds: loop.run_until_complete(asyncio.sleep(seconds))

    yield start
    assert not any(task.done() for task in tasks)


def test_change_is_looked_at_twice(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 1)
    graph, wait = watch(links)
    wait(2.0)
    assert links.looks == []
    graph.changed()
    wait(5.0)
    assert links.looks == pytest.approx([2.0, 3.0])


def test_restless_graph_is_looked_at_every_quarter_second(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 30)
    graph, wait = watch(links)
    for _ in range(10_000):
        graph.changed()
        wait(0.001)
    assert 38 <= len(links.looks) <= 41
    wait(1.5)
    assert links.looks[-1] == pytest.approx(11.0, abs=0.3)


def test_route_that_a_key_endangers_looks_at_each_change(loop: VirtualLoop, watch: Any, context: Context) -> None:
    links = Links(loop, 2)
    graph, wait = watch(links)
    graph.changed()
    wait(0.1)
    assert links.looks == pytest.approx([0.0])
    keyed: Any = context.shared(KeyedRoutes)
    keyed.add(links.routes["0"])
    graph.changed()
    wait(0.1)
    assert links.looks == pytest.approx([0.0, 0.1])
    keyed.clear()
    graph.changed()
    wait(0.01)
    assert links.looks == pytest.approx([0.0, 0.1])


def test_routes_look_twenty_at_a_time(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 500)
    graph, wait = watch(links)
    graph.changed()
    wait(0.1)
    assert len(links.looks) == 1
    assert links.most_in_one_go == 20


def test_looks_cost_at_most_tenth_of_time(loop: VirtualLoop, watch: Any) -> None:
    """A look of 0.1 s: one a second, however fast the graph changes."""
    links = Links(loop, 500, cost=0.0002)
    graph, wait = watch(links)
    for _ in range(2000):
        graph.changed()
        wait(0.01)
    elapsed = loop.time()
    assert 0.08 < len(links.looks) * 500 * 0.0002 / elapsed < 0.11


def test_routes_look_now_and_then_although_nothing_changed(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 1)
    _, wait = watch(links)
    wait(35.0)
    assert len(links.looks) == 3


def test_idle_routes_look_once_a_minute_although_nothing_changed(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 1)
    links.routes["0"].idle = True
    graph, wait = watch(links)
    wait(150.0)
    assert len(links.looks) == 2
    graph.changed()
    wait(0.5)
    assert len(links.looks) == 3


def test_route_that_is_not_open_does_not_look(loop: VirtualLoop, watch: Any) -> None:
    links = Links(loop, 3)
    for route in links.routes.values():
        route.id = 0
    graph, wait = watch(links)
    graph.changed()
    wait(1.0)
    assert links.looks == []
