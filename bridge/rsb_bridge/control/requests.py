"""The commands that a console has given and that are not answered yet."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.control.protocol import Failed, ProtocolError, Reply, Request, Step
from rsb_bridge.model.benchmark import Outcome
from rsb_bridge.model.history import HistoryReport
from rsb_bridge.model.snapshot import PeekedMessage, Reloaded

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from rsb_bridge.control.commands import Command
    from rsb_bridge.model.snapshot import TopicInfo

T = TypeVar("T")


class Requests:
    """By their ids, which count on across connections."""

    def __init__(self) -> None:
        self._ids = itertools.count(1)
        self._waiting: dict[int, tuple[Future[object], Callable[[str], None] | None]] = {}

    def new(
        self, command: Command, answered: Future[object], step: Callable[[str], None] | None, *, undo: bool = False
    ) -> Request:
        """Return the message for a command.

        Args:
            command: to be done.
            answered: gets the answer.
            step: called with each step, or None.
            undo: whether it takes back an earlier command.
        """
        number = next(self._ids)
        self._waiting[number] = (answered, step)
        return Request(number, command, undo)

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
            kind = InvalidRequestError if message.invalid else EngineError
            answered.set_exception(kind(message.reason))
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


def as_text(value: object) -> str:
    """Of a command that gives a key, a type's description, or a message."""
    return _of(str, value)


def as_peeked(value: object) -> PeekedMessage | None:
    """Of `Peek`."""
    return None if value is None else _of(PeekedMessage, value)


def as_reloaded(value: object) -> Reloaded:
    """Of `Reload`."""
    return _of(Reloaded, value)


def as_history(value: object) -> HistoryReport:
    """Of `History`."""
    return _of(HistoryReport, value)


def as_outcome(value: object) -> Outcome:
    """Of `Bench`."""
    return _of(Outcome, value)


def as_topics(value: object) -> list[TopicInfo]:
    """Of `Topics`."""
    return list(_of(tuple, value))


def _of(kind: type[T], value: object) -> T:
    """An answer of the kind that was asked for.

    Raises:
        EngineError: it is another one.
    """
    if not isinstance(value, kind):
        raise EngineError("the bridge's answer is no answer to this command")
    return value
