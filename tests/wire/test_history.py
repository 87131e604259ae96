"""History headers."""

from __future__ import annotations

import struct

import pytest

from rsb_bridge.wire.headers import HistoryHeader, publisher_id, split_history
from rsb_bridge.wire.protocol_error import ProtocolError

PUBLISHER = bytes(range(16))


def test_a_header_and_its_content_come_apart_again() -> None:
    header = HistoryHeader(PUBLISHER, number=2**63 - 1, depth=5)
    assert split_history(header.pack() + b"content") == (header, b"content")
    assert split_history(header.pack()) == (header, b"")


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "a history header of 0 bytes"),
        (bytes(27), "a history header of 27 bytes"),
        (struct.pack(">16sQI", PUBLISHER, 1, 0), "a depth of 0"),
        (struct.pack(">16sQI", PUBLISHER, 2**63, 1), "message number 9223372036854775808"),
    ],
)
def test_what_is_no_header_is_refused_in_words(payload: bytes, words: str) -> None:
    with pytest.raises(ProtocolError, match=words):
        split_history(payload)


def test_every_gid_makes_an_id() -> None:
    assert publisher_id(PUBLISHER) == PUBLISHER
    assert publisher_id(PUBLISHER + b"more") == PUBLISHER
    assert publisher_id(b"short") == b"short" + bytes(11)
