"""A command that undoes an earlier one is marked in the bridge's log, from another process, too."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from tests.console.scripted import ScriptedEngine
from tests.support.bridge import find, happened, now, route
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import is_undo, undoing
from rsb_bridge.model.session import Topic
from rsb_console.session.changes import Added, Removed, patterns_of

if TYPE_CHECKING:
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_console.session.changes import Change

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
    remote = machine.attach_to(engine)
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


# --- what the console remembers, on a bridge that runs


def _undo(engine: Engine, change: Change) -> None:
    asyncio.run(change.undo(now(engine), engine.events()).act(engine))


def test_a_removed_topic_is_as_it_was(bridge: Bridge) -> None:
    _, engine = bridge.both(Topic("/scan", "transmit", max_rate=5.0, arm=True, paused=True))
    eventually(lambda: route(engine, "/scan").arming is not None, what="both sides demand arming")
    before = route(engine, "/scan")
    change = Removed("robot1", "/scan", 0, key=before.key, spec=before.spec, pattern="", patterns=())
    engine.remove_topic(before.key).result(60)
    _undo(engine, change)
    after = route(engine, "/scan")
    assert (after.key, after.spec) == (before.key, before.spec)
    arming = eventually(lambda: route(engine, "/scan").arming)
    assert not arming.armed


def test_pattern_takes_in_again_what_it_excluded(bridge: Bridge, robot: Domain) -> None:
    robot.publisher("/camera/a")
    engine = bridge.client(Topic("/camera/*", "transmit"))
    bridge.server()
    before = route(engine, "/camera/a")
    patterns = tuple((row.key, row.spec) for row in patterns_of(now(engine), "robot1"))
    change = Removed(
        "robot1", "/camera/a", 0, key=before.key, spec=before.spec, pattern=before.pattern, patterns=patterns
    )
    engine.remove_topic(before.key).result(60)
    eventually(lambda: find(engine, "/camera/a") is None)
    _undo(engine, change)
    assert route(engine, "/camera/a").pattern == "/camera/*"
    assert tuple((row.key, row.spec) for row in patterns_of(now(engine), "robot1")) == patterns


def test_added_topic_that_pattern_matches_is_patterns_again(bridge: Bridge, robot: Domain) -> None:
    robot.publisher("/camera/a")
    engine = bridge.client(Topic("/camera/*", "transmit"))
    bridge.server()
    route(engine, "/camera/a")
    spec = Topic("/camera/a", "transmit", max_rate=2.0)
    key = engine.add_topic(spec).result(60)
    assert route(engine, "/camera/a").pattern == ""
    _undo(engine, Added("robot1", "/camera/a", 0, key=key, spec=spec))
    assert route(engine, "/camera/a").pattern == "/camera/*"
    assert route(engine, "/camera/a").spec.max_rate is None
