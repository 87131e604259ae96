"""The room for what late joiners get, of whatever sizes a recording has."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from rsb_extras.playing.latched_room import LatchedRoom
from rsb_extras.playing.tests.playing_places import LATCHED_BYTES
from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

if TYPE_CHECKING:
    import pytest

MAP = StoredChannel("/map", "nav_msgs/msg/OccupancyGrid", "cdr", "", ("", b""), "", "")


def maps(*sizes: int) -> list[StoredMessage]:
    return [StoredMessage(MAP, at, at, at, memoryview(bytes(size))) for at, size in enumerate(sizes, 1)]


def publishers(kept: int) -> Any:
    played = SimpleNamespace(kept=kept)
    return SimpleNamespace(of=lambda _: played)


def test_a_message_without_room_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    LATCHED_BYTES.set(monkeypatch, 100)
    room = LatchedRoom()
    for _ in range(3):  # each time an operator seeks
        assert [each.time for each in room.newest(maps(60, 60), publishers(2))] == [2]
    assert room.left_out == {"/map": 1}


def test_what_newer_ones_replace_is_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    LATCHED_BYTES.set(monkeypatch, 100)
    room = LatchedRoom()
    assert [each.time for each in room.newest(maps(150, 60, 30), publishers(2))] == [2, 3]
    assert not room.left_out


class Deep:
    """A publisher that counts how often it was made anew."""

    kept = 2

    def __init__(self) -> None:
        self.renewed = 0

    def renew(self) -> None:
        self.renewed += 1


def test_what_was_before_a_seek_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    LATCHED_BYTES.set(monkeypatch, 100)
    room = LatchedRoom()
    before: Any = Deep()
    after: Any = Deep()
    (first, second, third, fourth) = maps(60, 40, 60, 60)
    assert room.take(before, first)
    assert not room.take(after, third), "a late joiner needs what is there"
    room.seek()
    assert room.take(after, second), "there is room beside it"
    assert before.renewed == 0
    assert room.take(after, third)
    assert not room.take(before, fourth)
    assert (before.renewed, after.renewed) == (1, 0)
