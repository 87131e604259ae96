"""A lost bridge is shown as lost within the documented time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    import pytest
    from tests.support.control import Machine


def test_whoever_hears_of_the_loss_sees_it(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    server = machine.serve()
    remote = machine.attach()
    seen: list[tuple[str, bool]] = []
    log = remote._log
    add = log.add

    def look_and_add(level: Any, code: EventCode, text: str) -> None:
        seen.append((remote.unreachable, remote.snapshot().running))
        add(level, code, text)

    monkeypatch.setattr(log, "add", look_and_add)
    server.close("the bridge was stopped")
    eventually(lambda: any(event.code == EventCode.ATTACH_LOST for event in remote.events()))
    assert seen == [("the bridge was stopped", False)]
