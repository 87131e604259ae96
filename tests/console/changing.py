"""A scripted engine whose snapshot follows its commands."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
from tests.console.scripted import ScriptedEngine, refused, route

from rsb_bridge.model.commands import AddTopic, Command, EditTopic, PauseTopics, RemoveTopic, is_undo
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from concurrent.futures import Future

SCAN = Topic("/scan", "transmit", max_rate=5.0, priority="high")
ARMED = Topic("/cmd_vel", "receive", arm=True)


class ChangingEngine(ScriptedEngine):
    """An engine whose snapshot follows its commands; it notes whether each one is an undo."""

    specs: tuple[Topic, ...] = (SCAN, ARMED)

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.undone: list[tuple[object, ...]] = []
        self.show(*(route(spec.topic, spec=spec) for spec in self.specs))

    def show(self, *routes: Any) -> None:
        self.now = replace(self.now, routes=routes)

    def _done(self, result: Any, *command: object) -> Future[Any]:
        if is_undo():
            self.undone.append(command)
        return super()._done(result, *command)

    def put(self, key: str, spec: Topic) -> None:
        """Change a route, as any operator may."""
        state = State.PAUSED if spec.paused else State.OK
        changed = [replace(each, spec=spec, state=state) if each.key == key else each for each in self.now.routes]
        self.show(*changed)

    def spec(self, key: str) -> Topic:
        return next(each.spec for each in self.now.routes if each.key == key)

    def _execute(self, command: Command[Any], step: Any) -> Future[Any]:
        match command:
            case AddTopic(topic):
                self.show(*self.now.routes, route(topic.topic, spec=topic))
            case EditTopic(key, topic, _, seen):
                if seen is not None and any(each.key == key and each.spec != seen for each in self.now.routes):
                    return refused("it was changed meanwhile")
                self.put(key, topic)
            case RemoveTopic(key):
                self.show(*(each for each in self.now.routes if each.key != key))
            case PauseTopics(key, paused):
                self.put(key, msgspec.structs.replace(self.spec(key), paused=paused))
        return super()._execute(command, step)
