"""Tries of announced addresses: how many at a time, how often again, and what is remembered."""

from __future__ import annotations

import asyncio
from collections.abc import Collection

import pytest
from tests.support.held import held_by

from rsb_bridge.transport.trials import AT_ONCE, MOST_TRIED, Results, Trials, UnprovenError

pytestmark = pytest.mark.usefixtures("loop")


class Network:
    """Addresses of which some prove the key after some s; the others are silent, or refuse.

    Attributes:
        tried: when each address was tried.
        running: tries that run now.
        most: tries that ran at a time.
        discarded: results that came too late.
    """

    def __init__(self, **proves_after: float) -> None:
        self.proves_after = proves_after
        self.refuses: set[str] = set()
        self.tried: dict[str, list[float]] = {}
        self.running = self.most = 0
        self.discarded: list[str] = []
        self.trials: Trials[str] = Trials(lambda: asyncio.get_running_loop().time())

    async def attempt(self, address: str) -> str:
        now = asyncio.get_running_loop().time()
        self.tried.setdefault(address, []).append(now)
        self.running += 1
        self.most = max(self.most, self.running)
        try:
            if address in self.refuses:
                raise UnprovenError(address)
            await asyncio.sleep(self.proves_after.get(address, 1e9))
        finally:
            self.running -= 1
        return address

    async def search(self, announced: Collection[str]) -> Results[str]:
        return await self.trials.search(announced, self.attempt, self.discarded.append)


def fakes(count: int) -> list[str]:
    return [f"fake{number}" for number in range(count)]


async def test_single_address_is_used_once_proven() -> None:
    network = Network(real=0.05)
    results = await network.search(["real"])
    assert (list(results.proven), results.others) == (["real"], 0)
    assert asyncio.get_running_loop().time() == pytest.approx(0.05)


@pytest.mark.parametrize(("count", "within"), [(1, 0.5), (30, 0.5), (1000, 3.0)])
async def test_silent_ones_cost_little_time(count: int, within: float) -> None:
    network = Network(real=0.05)
    results = await network.search([*fakes(count), "real"])
    assert (list(results.proven), results.others) == (["real"], count)
    assert asyncio.get_running_loop().time() < within
    assert network.running == 0


async def test_proven_address_is_tried_first_next_time() -> None:
    network = Network(real=0.05)
    await network.search([*fakes(1000), "real"])
    began = asyncio.get_running_loop().time()
    await network.search([*fakes(1000), "real"])
    assert asyncio.get_running_loop().time() - began < 0.5


async def test_two_that_prove_the_key_are_both_found() -> None:
    network = Network(one=0.05, two=0.2)
    assert set((await network.search(["one", *fakes(10), "two"])).proven) == {"one", "two"}


async def test_what_fails_is_tried_less_and_less_often() -> None:
    network, announced = Network(), fakes(100)
    network.refuses = set(announced)
    loop = asyncio.get_running_loop()
    while loop.time() < 600:
        await network.search(announced)
        await asyncio.sleep(1.0)
    assert max(len(times) for times in network.tried.values()) < 60  # of 600 searches


async def test_a_few_are_tried_each_time() -> None:
    network = Network()
    network.refuses = {"wrong key"}
    for _ in range(20):
        await network.search(["wrong key"])
        await asyncio.sleep(1.0)
    assert len(network.tried["wrong key"]) == 20


async def test_tries_and_memory_are_bounded() -> None:
    network = Network()
    for life in range(5):
        await network.search([f"{life}.{number}" for number in range(5000)])
    assert network.most <= MOST_TRIED
    assert held_by(network.trials) <= 5000
    for times in network.tried.values():
        assert len(times) == 1
    begun: dict[float, int] = {}
    for (time,) in network.tried.values():
        begun[time] = begun.get(time, 0) + 1
    assert max(begun.values()) <= AT_ONCE


async def test_a_cancelled_search_leaves_nothing_behind() -> None:
    network = Network(real=0.05)
    search = asyncio.create_task(network.search([*fakes(50), "real"]))
    await asyncio.sleep(0.1)
    search.cancel()
    await asyncio.gather(search, return_exceptions=True)
    assert network.running == 0
    assert network.discarded == ["real"]


async def test_no_announcement_at_all_is_no_error() -> None:
    assert (await Network().search([])).proven == {}
