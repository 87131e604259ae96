"""The log names the way that carries a link whose streams use several."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rsb_bridge.link import subflows
from rsb_bridge.link.subflows import Subflows
from rsb_bridge.transport.multipath import Subflow

OWN, PEER = ("192.0.2.2", "192.0.2.3"), "192.0.2.1"


class Watched:
    """A link with two ways, and the lines of its log."""

    def __init__(self, *, is_client: bool = True) -> None:
        self.lines: list[str] = []
        self.ways: list[Subflow] = []
        link: Any = SimpleNamespace(
            is_client=is_client,
            control=SimpleNamespace(stream=SimpleNamespace(subflows=lambda: self.ways)),
            log_of_peer=lambda level, code, text, *, link_status: self.lines.append(text),
        )
        self.link = link
        self.watch = Subflows(link)

    def pass_(self, *sent_ago: float, silent: int | None = None) -> None:
        """Let a second pass, after which data went each way so long ago (s)."""
        ends = zip(OWN, (PEER, PEER), sent_ago, strict=False)
        self.ways = [Subflow(own, peer, ago, number != silent) for number, (own, peer, ago) in enumerate(ends)]
        self.watch.tick()


@pytest.fixture(autouse=True)
def devices(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Any machine may have these addresses: each one's device is told here."""
    devices: dict[str, str] = {}
    monkeypatch.setattr(subflows, "device_of", lambda address: devices.get(address, ""))
    return devices


def test_way_is_named_by_its_device(devices: dict[str, str]) -> None:
    devices[OWN[0]] = "wlan0"
    watched = Watched()
    watched.pass_(0.1, 1.0)
    assert watched.lines == ["carried via wlan0 (192.0.2.3 ready)"]
    assert watched.watch.used == "wlan0"


def test_carrying_way_is_told_when_it_changes() -> None:
    watched = Watched()
    watched.pass_(0.1)
    assert (watched.lines, watched.watch.ways, watched.watch.used) == ([], (), "")
    for seconds in range(3):
        watched.pass_(0.1, 10.0 + seconds)
    assert watched.lines == ["carried via 192.0.2.2 (192.0.2.3 ready)"]
    assert [(way.host, way.is_used, way.is_ready) for way in watched.watch.ways] == [
        (OWN[0], True, True),
        (OWN[1], False, True),
    ]
    watched.pass_(0.4, 0.0, silent=0)
    watched.pass_(3.0, 0.0)  # it answers again, and carries nothing yet
    watched.pass_(0.0, 1.0)
    watched.pass_(0.0, 2.0)
    assert watched.lines[1:] == [
        "carried via 192.0.2.3 (192.0.2.2 not ready)",
        "carried via 192.0.2.3 (192.0.2.2 ready)",
        "carried via 192.0.2.2 (192.0.2.3 ready)",
    ]
    watched.pass_(0.0)  # the kernel has given the other one up
    assert watched.lines[-1] == "carried via 192.0.2.2 (no other way)"
    assert watched.link.control.stream.own_address == OWN[0]
    watched.watch.suspend()
    assert not watched.watch.ways


def test_two_ways_that_both_carry_are_told_once() -> None:
    watched = Watched()
    for seconds in range(20):
        watched.pass_(seconds % 2, (seconds + 1) % 2)
    assert len(watched.lines) == 1


def test_link_without_connection_has_no_way() -> None:
    watched = Watched()
    watched.pass_(0.0, 1.0)
    watched.link.control = None
    watched.watch.tick()
    assert not watched.watch.ways
