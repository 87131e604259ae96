"""The GUIDs of publishers with Cyclone DDS, whose functions are a stand-in here: it does not come as a wheel."""

from __future__ import annotations

import ctypes
import sys

import pytest
from tests.support import replaced

from rsb_bridge.ros.native import cyclone_dds

GONE = 7


class Library:
    """Knows a publisher for every handle but `GONE`."""

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.lent: dict[int, ctypes.Array[ctypes.c_char]] = {}

    def matched_publication(self, _entity: int, handle: int) -> int:
        self.asked.append(handle)
        if handle == GONE:
            return 0
        data = ctypes.create_string_buffer(guid(handle) + b"the rest of the struct")
        address = ctypes.addressof(data)
        self.lent[address] = data
        return address

    def free_endpoint(self, address: int) -> None:
        del self.lent[address]


def guid(handle: int) -> bytes:
    return handle.to_bytes(16, "big")


def told(handle: int) -> bytes:
    return handle.to_bytes(8, sys.byteorder) + bytes(8)


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Library:
    library = Library()
    replaced.CYCLONE_LIBRARY.set(monkeypatch, lambda: library)
    replaced.CYCLONE_ENTITY.set(monkeypatch, lambda _: 1)
    replaced.CYCLONE_SUBSCRIPTION.set(monkeypatch, lambda _: 1)
    return library


def test_each_publisher_is_asked_for_once(library: Library) -> None:
    publishers = cyclone_dds.SubscriptionPublishers(1)
    assert [publishers.guid_of(told(handle)) for handle in (1, 2, 1)] == [guid(1), guid(2), guid(1)]
    assert library.asked == [1, 2]
    assert not library.lent


def test_departed_publisher_keeps_what_its_message_told(library: Library) -> None:
    publishers = cyclone_dds.SubscriptionPublishers(1)
    assert publishers.guid_of(told(GONE)) == told(GONE)
    assert publishers.guid_of(told(GONE)) == told(GONE)
    assert library.asked == [GONE, GONE]


def test_the_oldest_of_many_publishers_is_forgotten(library: Library) -> None:
    publishers = cyclone_dds.SubscriptionPublishers(1)
    for handle in (*range(1000, 2025), 1001, 1000):
        publishers.guid_of(told(handle))
    assert library.asked == [*range(1000, 2025), 1000]
