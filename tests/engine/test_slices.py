"""Long work leaves the I/O loop to messages: it is done in slices, of which all together have one part of a turn."""

from __future__ import annotations

import asyncio

from tests.support.offline import loop
from tests.support.virtual_time import VirtualLoop

from rsb_bridge.engine.io_loop import IoLoop
from rsb_bridge.tasks import MOST_AT_ONCE, SLICE, in_slices, turn_began

__all__ = ["loop"]


def counted(loop: VirtualLoop, items: int, takes: float) -> list[int]:
    """Return how many items each turn of the loop has had of work that takes so long (s) for each."""
    turns: list[int] = [0]

    def work(_: int) -> None:
        turns[-1] += 1
        loop.jump(takes)

    def turn() -> None:
        turns.append(0)
        loop.call_soon(turn)

    async def main() -> None:
        turn()
        await in_slices(range(items), work)

    loop.run_until_complete(main())
    return [each for each in turns if each]


def test_slice_ends_by_time(loop: VirtualLoop) -> None:
    assert counted(loop, 10, 0.4 * SLICE) == [3, 3, 3, 1]


def test_slice_has_one_item_at_least(loop: VirtualLoop) -> None:
    assert counted(loop, 3, 5 * SLICE) == [1, 1, 1]


def test_slice_ends_although_time_stands_still(loop: VirtualLoop) -> None:
    assert counted(loop, 2 * MOST_AT_ONCE + 1, 0.0) == [MOST_AT_ONCE, MOST_AT_ONCE, 1]


def test_works_in_slices_share_a_turn() -> None:
    class Noting(VirtualLoop):
        """Notes when its turn began, as the bridge's loop does."""

        turn_began = 0.0

        def _run_once(self) -> None:
            self.turn_began = self.time()
            super()._run_once()  # type: ignore[misc]

    loop = Noting()
    turns: list[list[str]] = [[]]

    def turn() -> None:
        turns.append([])
        loop.call_soon(turn)

    def work(name: str) -> None:
        turns[-1].append(name)
        loop.jump(0.4 * SLICE)

    async def main() -> None:
        turn()
        await asyncio.gather(in_slices("aaaaaa", work), in_slices("bbb", work))

    loop.run_until_complete(main())
    loop.close()
    assert [each for each in turns if each][:2] == [["a", "a", "a", "b"], ["a", "a", "a", "b"]]


def test_loop_notes_when_its_turn_began() -> None:
    began: list[float] = []

    async def main() -> None:
        running = asyncio.get_running_loop()
        for _ in range(2):
            before = running.time()
            await asyncio.sleep(0.001)
            began.append(turn_began(running) - before)
            assert turn_began(running) <= running.time()

    with asyncio.Runner(loop_factory=IoLoop) as runner:
        runner.run(main())
    assert all(each > 0.0 for each in began)
