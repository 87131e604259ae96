"""Ids of latched publishers, from which a new process of the sending side sees what was sent again."""

from __future__ import annotations

import pytest

from rsb_bridge.wire.headers import MOST_RESENDS, PUBLISHER_ID_LENGTH, publisher_id, resends_of

_GID = bytes(range(24))


def test_ids_of_a_publisher_differ() -> None:
    ids = {publisher_id(_GID, resent) for resent in range(MOST_RESENDS)}
    assert len(ids) == MOST_RESENDS
    assert {len(each) for each in ids} == {PUBLISHER_ID_LENGTH}
    assert publisher_id(_GID) == _GID[:PUBLISHER_ID_LENGTH]


@pytest.mark.parametrize(
    ("kept", "last"), [((), None), ((0,), 0), ((3,), 3), ((0, 1), 1), ((2, 3), 3), ((MOST_RESENDS - 1, 0), 0)]
)
def test_last_kept_id_tells_how_often_it_was_sent_again(kept: tuple[int, ...], last: int | None) -> None:
    """For a moment the peer keeps the id before, too."""
    assert resends_of(_GID, [publisher_id(_GID, each) for each in kept]) == last


def test_another_publishers_id_tells_nothing() -> None:
    assert resends_of(_GID, [publisher_id(b"another")]) is None
