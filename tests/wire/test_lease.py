"""The lease header, which says how old a message can be."""

from __future__ import annotations

import pytest

from rsb_bridge.wire.headers import LAST_LEASE, split_number, with_number
from rsb_bridge.wire.protocol_error import ProtocolError


@pytest.mark.parametrize("number", [0, 1, LAST_LEASE])
@pytest.mark.parametrize("content", [b"", b"content"])
def test_the_number_stands_before_the_content(number: int, content: bytes) -> None:
    packed = with_number(number, content)
    assert packed == number.to_bytes(4, "big") + content
    assert split_number(packed) == (number, content)


def test_a_header_that_is_cut_is_refused() -> None:
    with pytest.raises(ProtocolError):
        split_number(b"\0\0\0")
