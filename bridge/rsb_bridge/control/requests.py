"""The commands that a console has given and that are not answered yet."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control.protocol import Failed, ProtocolError, Reply, Request, Step
from rsb_bridge.model.benchmark import Outcome
from rsb_bridge.model.history import HistoryReport
from rsb_bridge.model.peek import PeekedMessage
from rsb_bridge.model.reloaded import Reloaded

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from rsb_bridge.control.commands import Command
    from rsb_bridge.model.snapshot import TopicInfo


class Requests:
    """By their ids, which count on across connections."""

    def __init__(self) -> None:
        self._ids = itertools.count(1)
        self._waiting: dict[int, tuple[Future[object], Callable[[str], None] | None]] = {}

    def new(self, command: Command, answered: Future[object], step: Callable[[str], None] | None) -> Request:
        """The message for a command.

        Args:
            command: to be done.
            answered: gets the answer.
            step: is told of each step; None: nobody is.
        """
        number = next(self._ids)
        self._waiting[number] = (answered, step)
        return Request(number, command)

    def take(self, message: Reply | Failed | Step) -> None:
        """Hand on what the bridge says of a command.

        Raises:
            ProtocolError: nobody has asked for that.
        """
        if isinstance(message, Step):
            _, step = self._waiting.get(message.id, (None, None))
            if step is not None:
                step(message.text)
            return
        answered, _ = self._waiting.pop(message.id, (None, None))
        if answered is None:
            raise ProtocolError("an answer without a request")
        if isinstance(message, Failed):
            answered.set_exception(EngineError(message.reason))
        else:
            answered.set_result(message.reloaded or message.history or message.bench or message.value)

    def fail(self, reason: str) -> None:
        """No answer will come to any of them."""
        waiting, self._waiting = self._waiting, {}
        for answered, _ in waiting.values():
            answered.set_exception(EngineError(f"no answer: {reason}"))


# --- what kind of answer a command has


def as_nothing(_: object) -> None:
    """Of a command that only succeeds or fails."""
    return


def as_peeked(value: object) -> PeekedMessage | None:
    """Of `Peek`."""
    assert value is None or isinstance(value, PeekedMessage)
    return value


def as_reloaded(value: object) -> Reloaded:
    """Of `Reload`."""
    assert isinstance(value, Reloaded)
    return value


def as_history(value: object) -> HistoryReport:
    """Of `History`."""
    assert isinstance(value, HistoryReport)
    return value


def as_outcome(value: object) -> Outcome:
    """Of `Bench`."""
    assert isinstance(value, Outcome)
    return value


def as_topics(value: object) -> list[TopicInfo]:
    """Of `Topics`."""
    assert isinstance(value, tuple)
    return list(value)
