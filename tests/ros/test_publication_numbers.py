"""The numbers of publications tell what no subscription took, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support import constants

from rsb_bridge.ros.publication_numbers import PublicationNumbers, Untaken

if TYPE_CHECKING:
    import pytest

OLD, NEW = b"old", b"new"


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def takes(numbers: PublicationNumbers, publisher: bytes, *taken: int) -> None:
    """Take messages as a reader does."""
    for number in taken:
        previous = numbers.newest.get(publisher)
        if previous is None:
            previous = numbers.first(publisher, number)
        if number > previous + 1:
            numbers.lose(number - previous - 1)
        numbers.newest[publisher] = number


def untaken(numbers: PublicationNumbers) -> tuple[int, int, int]:
    return tuple(numbers.counts[each] for each in (Untaken.LOST, Untaken.MISSED, Untaken.UNSUBSCRIBED))  # type: ignore[return-value]


def test_gaps_count_by_their_reasons() -> None:
    clock = Clock()
    numbers = PublicationNumbers(clock)
    numbers.begin(frozenset({OLD}))
    takes(numbers, OLD, 101, 102, 105)
    assert untaken(numbers) == (2, 0, 100)
    clock.now = 6.0
    takes(numbers, NEW, 4)
    assert untaken(numbers) == (5, 0, 100), "a publisher that comes later should be heard from its first message on"

    numbers.gap = Untaken.MISSED
    numbers.begin(frozenset({OLD, NEW}))
    takes(numbers, OLD, 116, 117)
    assert untaken(numbers) == (5, 10, 100)
    numbers.begin(frozenset({OLD, NEW}))  # replaced, and nobody says why
    takes(numbers, NEW, 7)
    takes(numbers, OLD, 118)
    assert untaken(numbers) == (7, 10, 100)


def test_publisher_that_came_meanwhile_is_missed_from_its_first_message_on() -> None:
    numbers = PublicationNumbers(Clock())
    numbers.begin(frozenset())
    numbers.gap = Untaken.MISSED
    numbers.begin(frozenset({NEW}))
    takes(numbers, NEW, 31)
    assert untaken(numbers) == (0, 30, 0)


def test_history_that_comes_again_is_no_gap() -> None:
    numbers = PublicationNumbers(Clock())
    numbers.begin(None)
    takes(numbers, OLD, 3, 4, 5)
    numbers.gap = Untaken.MISSED
    numbers.begin(None)
    takes(numbers, OLD, 4, 5, 6)
    assert untaken(numbers) == (0, 0, 2)
    numbers.gap = Untaken.MISSED
    numbers.begin(None)
    takes(numbers, OLD, 9, 10)
    assert untaken(numbers) == (0, 2, 2), "its publisher keeps two, and has kept neither 7 nor 8"


def test_messages_without_numbers_count_nothing() -> None:
    numbers = PublicationNumbers(Clock())
    for _ in range(2):
        numbers.begin(frozenset({OLD}))
        takes(numbers, OLD, 0, 0)
    assert untaken(numbers) == (0, 0, 0)


def test_forgotten_publisher_counts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    constants.PUBLISHERS_REMEMBERED.set(monkeypatch, 3)
    numbers = PublicationNumbers(Clock())
    numbers.begin(frozenset({OLD}))
    takes(numbers, OLD, 11)
    for number in range(5):
        takes(numbers, b"%d" % number, 1)
    takes(numbers, OLD, 41)
    assert untaken(numbers) == (0, 0, 10)
    assert len(numbers.newest) <= 3
