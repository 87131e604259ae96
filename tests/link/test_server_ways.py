"""A client tries the ways to its server that it does not use, and moves to a better one that has held."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.link.connecting import Failure
from rsb_bridge.link.server_ways import HELD_FOR, ServerWays, first_of
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.route.arming import ArmingPhase

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

WIFI, LTE = "10.0.0.1", "10.8.0.1"


class Link:
    """A link that is up over one of two ways, and what its network does.

    Attributes:
        answers: the hosts that accept a connection.
        sources: where a new connection to a host leaves from.
        tried: each host that was tried, and when (s).
    """

    def __init__(self, context: Context, used: str) -> None:
        self.context, self.transport, self.linked, self.awake = context, self, True, list[Any]()
        self.answers = {WIFI, LTE}
        self.sources = {WIFI: "10.0.0.2", LTE: "10.8.0.2"}
        self.control = SimpleNamespace(stream=SimpleNamespace(host=used, own_address=self.sources[used]))
        self.tried: list[tuple[str, float]] = []
        self.ways = ServerWays(self, (WIFI, LTE))  # type: ignore[arg-type]
        self.ways.take(used)

    def shared_port(self) -> int:
        return 49152

    def spawn(self, work: Any) -> Any:
        return self.context.loop.create_task(work)

    def source_address(self, host: str) -> str:
        return self.sources[host]

    async def connect(self, host: str, _: int, __: Any) -> Any:
        self.tried.append((host, self.context.now()))
        if host not in self.answers:
            raise ConnectionRefusedError
        return SimpleNamespace(abort=lambda _: None)

    def moves_within(self, seconds: int) -> tuple[str, float] | None:
        """Return where the link moves within so many seconds, and after how many, or None."""
        for second in range(seconds):
            if (host := self.ways.tick()) is not None:
                return host, second
            self.context.loop.run_until_complete(asyncio.sleep(1.0))
        return None


def test_link_moves_back_to_a_better_way_that_has_held(context: Context) -> None:
    link = Link(context, LTE)
    link.answers.remove(WIFI)
    assert link.moves_within(30) is None
    link.answers.add(WIFI)
    assert link.moves_within(5) is None
    link.answers.remove(WIFI)  # its 10 s begin again here
    assert link.moves_within(5) is None
    link.answers.add(WIFI)
    moved = link.moves_within(30)
    assert moved is not None
    host, after = moved
    assert host == WIFI
    assert HELD_FOR <= after <= HELD_FOR + 5
    assert LTE not in {host for host, _ in link.tried}
    link.ways.failed(WIFI)
    assert link.moves_within(9) is None


def test_link_does_not_move_back_while_anything_is_armed(context: Context) -> None:
    link = Link(context, LTE)
    link.awake.append(SimpleNamespace(arming=SimpleNamespace(phase=ArmingPhase.ARMED)))
    assert link.moves_within(60) is None
    link.awake.clear()
    assert link.moves_within(1) == (WIFI, 0)


def test_worse_way_is_tried_once_a_minute(context: Context) -> None:
    link = Link(context, WIFI)
    assert link.moves_within(150) is None
    assert [round(at - link.tried[0][1]) for _, at in link.tried] == [0, 60, 120]
    assert [(way.host, way.is_used, way.is_ready) for way in link.ways.snapshots()] == [
        (WIFI, True, False),
        (LTE, False, True),
    ]
    link.answers.remove(LTE)
    link.ways.changed()
    assert link.moves_within(3) is None
    assert not link.ways.snapshots()[1].is_ready


def test_link_moves_where_the_routes_of_the_machine_lead(context: Context) -> None:
    link = Link(context, WIFI)
    link.sources[WIFI] = "10.0.0.3"
    moved = link.moves_within(30)
    assert moved is not None
    assert moved[0] == WIFI


def attempts(outcomes: dict[str, tuple[float, Failure | None]], began: list[str]) -> Callable[[str], Any]:
    async def connect(host: str) -> Failure | None:
        began.append(host)
        takes, outcome = outcomes[host]
        await asyncio.sleep(takes)
        return outcome

    return connect


DOWN = Failure("no route")


@pytest.mark.parametrize(
    ("first", "second", "began", "lasts"),
    [
        ((0.1, None), (0.1, None), [WIFI], 0.1),
        ((0.5, None), (5.0, None), [WIFI, LTE], 0.5),
        ((5.0, None), (0.1, None), [WIFI, LTE], 0.35),
        ((0.0, DOWN), (0.1, None), [WIFI, LTE], 0.1),
    ],
)
def test_first_host_that_answers_is_taken(
    loop: VirtualLoop, first: tuple[float, None], second: tuple[float, None], began: list[str], lasts: float
) -> None:
    tried: list[str] = []
    start = loop.time()
    assert loop.run_until_complete(first_of((WIFI, LTE), attempts({WIFI: first, LTE: second}, tried))) is None
    assert tried == began
    assert loop.time() - start == pytest.approx(lasts, abs=0.01)
    assert not asyncio.all_tasks(loop)


@pytest.mark.parametrize("takes", [0.0, 2.0])
def test_failures_of_all_hosts_read_the_same_whichever_comes_first(loop: VirtualLoop, takes: float) -> None:
    outcomes: dict[str, tuple[float, Failure | None]] = {
        WIFI: (takes, DOWN),
        LTE: (0.1, Failure("it refuses", LinkCause.NOT_A_BRIDGE)),
    }
    failure = loop.run_until_complete(first_of((WIFI, LTE), attempts(outcomes, [])))
    assert failure == Failure("it refuses; no route", LinkCause.NOT_A_BRIDGE)
