"""A feature hears of a console's snapshots and events, also of an attached one's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import drive, scripted_app, shown, until
from tests.support import replaced
from tests.support.bridge import is_accepted
from tests.support.waiting import eventually

from rsb_bridge import installed_features
from rsb_bridge.feature import Feature
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.support.bridge import Bridge
    from textual.pilot import Pilot


class _Listening(Feature):
    name = "listening"

    def __init__(self) -> None:
        self.snapshots: list[Any] = []
        self.events: list[Any] = []
        self.failed = 0

    def listeners(self, console: Any) -> Iterable[Any]:
        return self._fail, self._heard

    def _heard(self, snapshot: Any, events: Any) -> None:
        self.snapshots.append(snapshot)
        self.events += events

    def _fail(self, snapshot: Any, events: Any) -> None:
        self.failed += 1
        raise RuntimeError("it fails")


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> _Listening:
    feature = _Listening()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda method: (feature,) if method == "listeners" else ())
    monkeypatch.setattr(installed_features, "_faults", {})
    return feature


def test_failing_listener_hears_no_more_and_others_do(listening: _Listening) -> None:
    async def steps(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: len(listening.snapshots) > 2, "snapshots")

    drive(scripted_app(), steps)
    assert listening.failed == 1
    (fault,) = installed_features.feature_faults()
    assert (fault.feature, fault.method) == ("listening", "listeners")


def test_attached_console_tells_only_of_what_happens_meanwhile(
    listening: _Listening, bridge: Bridge, machine: Any
) -> None:
    _, client = bridge.both(Topic("/scan", "transmit", type="std_msgs/msg/String"))
    eventually(lambda: is_accepted(client, "/scan"), what="open")
    machine.serve(client)
    older = {each.number for each in client.events()}
    app = scripted_app(session=None, path=None, attach_to=machine.folder / "robot1.sock")

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/scan")
        await until(pilot, lambda: listening.snapshots, "a snapshot")
        client.add_topic(Topic("/more", "transmit", type="std_msgs/msg/String")).result(60)
        await until(pilot, lambda: any("/more" in each.text for each in listening.events), "an event")
        await until(pilot, lambda: any(each.topic == "/more" for each in listening.snapshots[-1].routes), "the topic")

    drive(app, steps)
    assert older
    assert older.isdisjoint(each.number for each in listening.events)
