"""Large messages on a stream of their own: whole, in order, and in nobody's way for long."""

from __future__ import annotations

import asyncio
import random

import pytest
from tests.channel.test_duplex import connected, on_its_own, play, until

_SIZES = (0, 1, 65_535, 65_536, 65_537, 262_143, 262_144, 262_145, 1 << 20, 6_000_000, 33 << 20)


def _payload(size: int) -> bytes:
    return random.Random(size).randbytes(min(size, 1 << 16)) * (-(-size // (1 << 16))) if size else b""


def test_messages_of_all_sizes_are_exact_and_in_order() -> None:
    sent = [_payload(size)[:size] for size in (*_SIZES, *reversed(_SIZES[:-1]))]

    async def scene() -> None:
        async with connected(on_its_own, (1, False)) as (here, there):
            here.routes[1].send(*sent)
            await until(lambda: len(there.routes[1].arrived) == len(sent))
            assert there.routes[1].arrived == sent
            assert there.keys.budget.held == 0
            assert not here.routes[1].channel.congested

    play(scene)


def test_messages_share_pieces() -> None:
    """Small messages next to large ones cost no call of their own."""
    sent = [_payload(size)[:size] for size in (20_000, 0, 20_000, 60_000, 300_000, 1, 0, 100_000)]

    async def scene() -> None:
        async with connected(on_its_own, (1, False)) as (here, there):
            written: list[int] = []
            write = here.stream.write

            def count(data: bytes | memoryview) -> None:
                written.append(len(data))
                write(data)

            here.stream.write = count  # type: ignore[method-assign]
            here.routes[1].channel.send([(payload, 0, 0) for payload in sent])
            await until(lambda: len(there.routes[1].arrived) == len(sent))
            assert there.routes[1].arrived == sent
            assert len(written) == 3

    play(scene)


def test_what_is_sent_meanwhile_comes_after_it() -> None:
    """Even by who does not ask whether the channel is congested."""

    async def scene() -> None:
        async with connected(on_its_own, (1, False)) as (here, there):
            channel = here.routes[1].channel
            channel.send([(bytes(8 << 20), 0, 0)])
            assert channel.congested
            channel.send([(b"small", 0, 0), (bytes(1 << 20), 0, 0), (b"", 0, 0)])
            await until(lambda: len(there.routes[1].arrived) == 4)
            assert [len(payload) for payload in there.routes[1].arrived] == [8 << 20, 5, 1 << 20, 0]

    play(scene)


def test_others_have_their_turn_while_a_message_goes() -> None:
    async def scene() -> None:
        async with connected(on_its_own, (1, False)) as (here, there):
            turns = 0

            async def others() -> None:
                nonlocal turns
                while not there.routes[1].arrived:
                    turns += 1
                    await asyncio.sleep(0)

            here.routes[1].send(bytes(32 << 20))
            await others()
            assert turns >= 32

    play(scene)


@pytest.mark.parametrize("turns", [0, 1, 3])
def test_nothing_is_sent_on_a_closed_channel(turns: int) -> None:
    async def scene() -> None:
        async with connected(on_its_own, (1, False)) as (here, there):
            here.routes[1].send(bytes(8 << 20))
            for _ in range(turns):
                await asyncio.sleep(0)
            here.routes[1].channel.close("removed")
            sent = here.stream.sent_bytes
            await until(lambda: there.routes[1].lost)
            assert here.stream.sent_bytes == sent
            assert there.keys.budget.held == 0
            assert not there.routes[1].arrived

    play(scene)
