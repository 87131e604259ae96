"""An engine that plays a script, and takes messages by hand."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from tests.console.driving import engine_as
from tests.console.scripted import ScriptedEngine, answered, refused

from rsb_bridge.api import EngineError
from rsb_extras.driving.publish_requests import Draft, DraftMessage, Publish, Published

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.commands import Command
    from rsb_console.app import ConsoleApp


class PublishingEngine(ScriptedEngine):
    """Answers with drafts, and with what it is to say of messages; without that, the test answers."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.drafts: dict[str, Draft] = {}
        self.published: list[Published | EngineError] = []
        self.publishing: Future[Published] = Future()

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        if isinstance(command, DraftMessage):
            self.commands.append(("draft", command.topic, command.type_name))
            draft = self.drafts.get(command.topic)
            return refused("nobody knows its type \x1b[2J") if draft is None else answered(draft)
        if not isinstance(command, Publish):
            return super()._execute(command, step)
        self.commands.append(("publish", command))
        self.publishing = Future()
        if self.published:
            answer = self.published.pop(0)
            return refused(str(answer)) if isinstance(answer, EngineError) else answered(answer)
        return self.publishing


def engine_of(app: ConsoleApp) -> PublishingEngine:
    return engine_as(app, PublishingEngine)
