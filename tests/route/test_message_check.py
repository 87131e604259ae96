"""Messages that are checked, and the bound of the time that one link's checks take."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from tests.support.held import held_by

from rsb_bridge.cdr.checker import STEPS, MalformedError, TooComplexError
from rsb_bridge.cdr.description import FieldType, MessageField, MessageType, TypeDescription, hash_of_text, text_of
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.ros.type_descriptions import TypeCheckers, TypeDescriptions
from rsb_bridge.route.message_check import CHECKED_A_SECOND, CHECKED_AT_ONCE, MessageCheck

NAMES = "made_up_msgs/msg/Names"
TEXT = text_of(TypeDescription(MessageType(NAMES, (MessageField("all", FieldType(161, 0, 0, "")),)), ()))
HASH = hash_of_text(TEXT)
SESSION = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=1)


def names(count: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<I", count) + bytes(4 * count)


class Ros(NoRos):
    """Types that are installed, and nodes that describe theirs."""

    def __init__(self, installed: dict[str, str], nodes: dict[str, str]) -> None:
        self.installed = installed
        self.nodes = nodes
        self.asked: list[str] = []

    def installed_hash(self, type_name: str) -> str | None:
        return hash_of_text(self.installed[type_name]) if type_name in self.installed else None

    def installed_description(self, type_name: str) -> str | None:
        return self.installed.get(type_name)

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return [Endpoint(node, NAMES, HASH, Qos(), b"") for node in self.nodes]

    def ask_description(self, *question: Any) -> str:
        node, _, type_hash, _ = question
        self.asked.append(type_hash)
        return self.nodes[node]


def as_any(value: object) -> Any:
    return value


class Bed:
    """A check, and a clock that stands."""

    def __init__(self, installed: dict[str, str], nodes: dict[str, str] | None = None) -> None:
        self.time = 0.0
        self.asks: list[asyncio.Task[None]] = []
        self.ros = as_any(Ros(installed, nodes or {}))
        loop = SimpleNamespace(create_task=self._create_task)
        self.context = as_any(SimpleNamespace(session=SESSION, ros=self.ros, loop=loop, now=lambda: self.time))
        descriptions = TypeDescriptions(self.ros, self.context.now)
        self.context.checkers = TypeCheckers(self.ros, descriptions)
        self.check = MessageCheck(self.context, TokenBucket(CHECKED_AT_ONCE, CHECKED_A_SECOND, 0.0))

    def _create_task(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        self.asks.append(asyncio.get_running_loop().create_task(work))
        return self.asks[-1]

    def look(self, *hashes: str) -> None:
        self.check.ask_subscribers("/names", [Endpoint("/node", NAMES, each, Qos(), b"") for each in hashes])


def run(work: Callable[[], Any]) -> None:
    asyncio.run(work())


def test_installed_type_is_checked_from_first_message() -> None:
    bed = Bed({NAMES: TEXT})
    bed.check.begin(NAMES)
    bed.check.check(names(3))
    with pytest.raises(MalformedError):
        bed.check.check(names(3)[:-1])
    bed.context.session = msgspec.structs.replace(SESSION, check_messages=False)
    bed.check.set()
    bed.check.check(names(3)[:-1])
    assert bed.check.checker is None
    bed.context.session = SESSION
    bed.check.set()
    assert bed.check.checker is not None


async def looked(bed: Bed) -> bool:
    """Wait until a check has asked for its type; return False if it does not ask."""
    asks, bed.asks = bed.asks, []
    for each in asks:
        await each
    return bool(asks)


def test_missing_type_is_described_by_its_subscribers() -> None:
    """The checker goes by the subscribers' hash, not by the peer's."""

    async def work() -> None:
        bed = Bed({}, {"/node": TEXT})
        bed.check.begin(NAMES)
        bed.look()
        assert bed.check.checker is None
        bed.look(HASH)
        assert await looked(bed)
        assert bed.ros.asked == [HASH]
        with pytest.raises(MalformedError):
            bed.check.check(names(3)[:-1])

    run(work)


def test_nodes_without_description_are_asked_later() -> None:
    async def work() -> None:
        bed = Bed({}, {"/node": "another text"})
        bed.check.begin(NAMES)
        for expected in (1, 1, 2):
            bed.look(HASH)
            await looked(bed)
            assert len(bed.ros.asked) == expected
            bed.check.check(b"anything")
            if expected == 1 and bed.time == 0.0:
                bed.time = 5.0
            else:
                bed.time = 20.0

    run(work)


def test_link_s_messages_take_bounded_part_of_time() -> None:
    bed = Bed({NAMES: TEXT})
    bed.check.begin(NAMES)
    for _ in range(CHECKED_AT_ONCE // STEPS):
        bed.check.check(names(STEPS))
    with pytest.raises(TooComplexError):
        bed.check.check(names(STEPS))
    with pytest.raises(TooComplexError):
        bed.check.check(names(100))
    bed.time += 200 / CHECKED_A_SECOND
    bed.check.check(names(100))
    bed.time += 10.0
    for _ in range(CHECKED_AT_ONCE // STEPS // 2):  # malformed ones are read again for the field, and cost more
        with pytest.raises(MalformedError):
            bed.check.check(names(STEPS)[:-4] + struct.pack("<I", 5))
    with pytest.raises(TooComplexError):
        bed.check.check(names(STEPS))


def test_claimed_length_costs_links_budget_nothing() -> None:
    """Eight bytes of one message do not have the messages that come with it dropped."""
    bed = Bed({NAMES: TEXT})
    bed.check.begin(NAMES)
    with pytest.raises(MalformedError):
        bed.check.check(b"\0\1\0\0" + struct.pack("<I", 1 << 28))
    bed.check.check(names(1000))


def test_checkers_are_bounded() -> None:
    texts = {f"t/msg/T{n}": text_of(_described(f"t/msg/T{n}")) for n in range(513)}
    bed = Bed(texts)
    kept = [bed.context.checkers.installed(name) for name in texts]
    assert all(kept)
    assert bed.context.checkers.installed("t/msg/T512") is kept[512]
    assert bed.context.checkers.installed("t/msg/T0") is not kept[0]
    assert held_by(bed.context.checkers) == 512


def _described(name: str) -> TypeDescription:
    return TypeDescription(MessageType(name, (MessageField("all", FieldType(161, 0, 0, "")),)), ())
