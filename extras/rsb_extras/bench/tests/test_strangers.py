"""A real server's memory while strangers flood it: one row of the bench for each transport."""

from __future__ import annotations

import pytest
from bench.strangers import FLAT, SHORT, Flood, measure
from tests.support.long import long


@pytest.mark.parametrize(
    "flood", [*long(SHORT[0]), SHORT[1], *long(SHORT[2])], ids=[flood.transport for flood in SHORT]
)
def test_flood_leaves_memory_and_link_as_they_were(flood: Flood, spare_domains: int) -> None:
    if flood.transport == "zenoh":
        pytest.importorskip("zenoh")
    row = measure(flood, spare_domains, spare_domains + 1)
    assert row.sent > 10
    assert row.linked is not None
    assert row.peak - row.before <= FLAT
    assert row.after - row.before <= FLAT
