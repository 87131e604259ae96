"""Messages that pass, for one that records and for several."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.model.qos import Qos
from rsb_extras.recording.passing_messages import PassingMessages

if TYPE_CHECKING:
    from rsb_extras.recording.message_ring import RingMessage


@pytest.fixture
def context() -> Any:
    return SimpleNamespace(now=lambda: 1.0, announcements=SimpleNamespace(is_own=lambda _: False), tap_of=None)


def test_a_message_is_known_once(context: Any) -> None:
    passing, publishers = PassingMessages(context), count()
    assert not passing.is_known(b"one", 1)
    assert passing.is_known(b"one", 1)
    assert not passing.is_known(b"one", 2)
    assert passing.is_known(b"one", 1), "it comes again to a new subscription"
    assert not passing.is_known(b"two", 1)
    assert not any(passing.is_known(b"%d" % next(publishers), 1) for _ in range(20_000)), "and strangers are bounded"


def test_all_takers_share_one_message(context: Any) -> None:
    passing = PassingMessages(context)
    first: list[RingMessage] = []
    second: list[RingMessage] = []
    passing.give(first.append)
    tap = context.tap_of("/chat", SimpleNamespace(type_name="std_msgs/msg/String", type_hash="RIHS01_", qos=Qos()))
    passing.give(second.append)
    tap(b"content", 2, 1, b"publisher", 1)
    tap(b"content", 3, 1, b"publisher", 1)  # again, over another link
    assert len(first) == len(second) == 1
    assert first[0] is second[0]
    passing.end(first.append)
    tap(b"content", 4, 3, b"publisher", 2)
    assert (len(first), len(second)) == (1, 2)
    passing.end(second.append)
    tap(b"content", 5, 4, b"publisher", 3)
    assert (len(first), len(second)) == (1, 2), "a view outlives the switch"
    assert context.tap_of("/chat", None) is None
