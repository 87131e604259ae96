"""History headers."""

from __future__ import annotations

import struct

import pytest
from tests.support.wording import pattern

from rsb_bridge.wire.headers import HistoryHeader, publisher_id, split_history
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

PUBLISHER = bytes(range(16))


def test_a_header_and_its_content_come_apart_again() -> None:
    header = HistoryHeader(PUBLISHER, number=2**63 - 1, depth=5)
    assert split_history(header.pack() + b"content") == (header, b"content")
    assert split_history(header.pack()) == (header, b"")


@pytest.mark.parametrize(
    ("payload", "broken", "parameters"),
    [
        (b"", Broken.HISTORY_HEADER_TOO_SHORT, {"length": 0}),
        (bytes(27), Broken.HISTORY_HEADER_TOO_SHORT, {"length": 27}),
        (struct.pack(">16sQI", PUBLISHER, 1, 0), Broken.HISTORY_HEADER_INVALID, {"depth": 0}),
        (struct.pack(">16sQI", PUBLISHER, 2**63, 1), Broken.HISTORY_HEADER_INVALID, {"number": 2**63}),
    ],
)
def test_what_is_no_header_is_refused_in_words(payload: bytes, broken: Broken, parameters: dict[str, object]) -> None:
    with pytest.raises(ProtocolError, match=pattern(broken, **parameters)):
        split_history(payload)


def test_every_gid_makes_an_id() -> None:
    assert publisher_id(PUBLISHER) == PUBLISHER
    assert publisher_id(PUBLISHER + b"more") == PUBLISHER
    assert publisher_id(b"short") == b"short" + bytes(11)
