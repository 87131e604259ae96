"""A command that takes back an earlier one says so, from another process, too: the bridge's log marks it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.console.scripted import ScriptedEngine
from tests.support.bridge import happened

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.operators import is_undo, undoing
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.control import Machine

MARK = "(undo)"


class _Engine(ScriptedEngine):
    """Notes of each command whether it takes back another."""

    def __init__(self) -> None:
        super().__init__()
        self.undone: list[bool] = []

    def _done(self, result: Any, *command: object) -> Future[Any]:
        self.undone.append(is_undo())
        return super()._done(result, *command)


def test_an_attached_console_says_what_is_an_undo(machine: Machine) -> None:
    engine = _Engine()
    machine.serve(engine)
    remote = machine.attach()
    remote.pause("/scan", True).result(60)
    with undoing():
        remote.pause("/scan", False).result(60)
    remote.pause("/scan", True).result(60)
    assert engine.undone == [False, True, False]


def test_the_log_says_so(bridge: Bridge) -> None:
    engine = bridge.client(Topic("/scan", "transmit"))
    (route,) = engine.snapshot().routes
    engine.edit_topic(route.key, Topic("/scan", "transmit", max_rate=5.0)).result(60)
    edited = happened(engine, EventCode.OPERATOR_EDITED)
    assert edited is not None
    assert MARK not in edited.text
    with undoing():
        engine.edit_topic(route.key, route.spec).result(60)
    undone = happened(engine, EventCode.OPERATOR_EDITED)
    assert undone is not None
    assert (undone.old, undone.new, undone.who) == (edited.new, edited.old, edited.who)
    assert undone.text.endswith(MARK)
