"""A feature's part or observer that fails in an engine ends nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support import replaced
from tests.support.bridge import happened, is_accepted, linked
from tests.support.waiting import eventually

from rsb_bridge.engine.part import EngineObserver, EnginePart
from rsb_bridge.feature import Feature
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pytest
    from tests.support.bridge import Bridge


class _Part(EnginePart):
    ticks = ends = 0

    def tick(self, snapshot: object) -> None:
        self.ticks += 1
        raise RuntimeError("it fails")

    async def close(self) -> None:
        raise RuntimeError("it fails again")

    def join(self) -> None:
        self.ends += 1
        raise RuntimeError("and again")


class _Observer(EngineObserver):
    ends = 0

    def start(self) -> None:
        raise RuntimeError("it fails")

    def stop(self, timeout: float) -> None:
        self.ends += 1
        raise RuntimeError("it fails again")


class _Failing(Feature):
    name = "failing"

    def __init__(self) -> None:
        self.part, self.observer = _Part(), _Observer()

    def observers(self, engine: Any) -> Iterable[Any]:
        return (self.observer,)

    def parts(self, bridge: Any) -> Iterable[Any]:
        return (self.part,)


def test_failing_part_ends_nothing_else(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    server, failing = bridge.server(), _Failing()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda _: (failing,))
    client = bridge.client(Topic("/scan", "transmit", type="std_msgs/msg/String"))
    bridge.expected.add(client)
    eventually(lambda: failing.part.ticks > 2, what="ticks")
    assert happened(client, EventCode.ENGINE_ERROR)
    eventually(lambda: linked(server) and is_accepted(client, "/scan"), what="open")
    client.stop()
    assert failing.part.ends == 1
    assert happened(client, EventCode.ENGINE_STOPPED)


def test_failing_observer_ends_nothing_else(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    server, failing = bridge.server(), _Failing()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda _: (failing,))
    client = bridge.client(Topic("/scan", "transmit", type="std_msgs/msg/String"))
    bridge.expected.add(client)
    assert happened(client, EventCode.ENGINE_ERROR)
    eventually(lambda: linked(server) and is_accepted(client, "/scan"), what="open")
    client.stop()
    assert failing.observer.ends == 1
    assert happened(client, EventCode.ENGINE_STOPPED)
