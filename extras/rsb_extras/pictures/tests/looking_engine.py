"""An engine that plays a script of pictures."""

from __future__ import annotations

from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from tests.console.scripted import ScriptedEngine

from rsb_extras.pictures.look_requests import EndLook, LookAtTopics

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.commands import Command
    from rsb_extras.pictures.picture import Viewed


class LookingEngine(ScriptedEngine):
    """Answers with what stands in `viewed`; later questions wait until the test answers `viewing`."""

    def __init__(self, *session: Any) -> None:
        super().__init__(*session)
        self.viewed: list[Viewed] = []
        self.viewing: Future[Viewed | None] = Future()
        self.viewing.cancel()  # nobody looks yet

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        if isinstance(command, EndLook):
            return self._done(None, "end_look")
        if not isinstance(command, LookAtTopics):
            return super()._execute(command, step)
        self.commands.append(("look", command.topics, command.wish, command.link))
        self.viewing = Future()  # until a picture comes
        if self.viewed:
            self.viewing.set_result(self.viewed.pop(0))
        return self.viewing
