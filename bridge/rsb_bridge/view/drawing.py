"""The interface of a view: it takes decoded messages, and draws a picture of them when one is wanted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.decoder import Items

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message, Value
    from rsb_bridge.model.pictures import Cells, Pixels, Series, Wish


class TakenMessage(NamedTuple):
    """A message that a view takes.

    Attributes:
        message: its values; arrays of primitive elements are raw (`rsb_bridge.cdr.decoder.Items.raw`).
        time: s since the epoch, when DDS received it.
        author: full name of the node that published it, or empty if unknown.
    """

    topic: str
    type_name: str
    message: Message
    time: float
    author: str = ""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A picture of a view's messages.

    Attributes:
        content: the picture, or None before the first message, or with a problem.
        problem: the reason why it is missing or incomplete, and what to do.
    """

    content: Pixels | Cells | Series | None = None
    notes: tuple[str, ...] = ()
    problem: str = ""


class UndrawableError(Exception):
    """A message cannot be drawn; the text says why, and what to do."""


class View(ABC):
    """One viewer's picture of one or more topics.

    It runs in a process of its own, which is killed if it takes too long or too much memory. Messages are not trusted:
    they may have any values that their types allow, NaN, wrong lengths and huge sizes included.

    Attributes:
        now: s since the epoch on the clock of `TakenMessage.time` when the picture is wanted, or 0.
    """

    now = 0.0

    @abstractmethod
    def receive(self, received: TakenMessage) -> None:
        """Take a message. Called for every message, or, if they are large or many, for the newest ones.

        Raises:
            UndrawableError: the message cannot be drawn; it is shown with the next picture.
        """

    @abstractmethod
    def draw(self, wish: Wish) -> Drawn:
        """Draw what has been taken so far.

        Raises:
            UndrawableError: nothing can be drawn.
        """


def nested(message: Message, path: str) -> Value | None:
    """Return a field of a message by its path (``header.frame_id``), or None if it is missing."""
    value: Value | None = message
    for name in path.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value


def number(message: Message, path: str) -> float:
    """Return a number by its path, or NaN if it is missing."""
    value = nested(message, path)
    return float(value) if isinstance(value, int | float) else float("nan")


def text(message: Message, path: str) -> str:
    """Return a string by its path, or an empty string if it is missing."""
    value = nested(message, path)
    return value if isinstance(value, str) else ""


def elements(message: Message, path: str) -> list[Message]:
    """Return the messages in an array by its path, or an empty list if it is missing."""
    value = nested(message, path)
    return [each for each in value.shown if isinstance(each, dict)] if isinstance(value, Items) else []


def raw(message: Message, path: str) -> tuple[memoryview, str]:
    """Return the bytes of an array of primitive elements by its path, and the code of one for `struct` and numpy.

    Raises:
        UndrawableError: the message has no such array.
    """
    value = nested(message, path)
    if not isinstance(value, Items) or value.raw is None:
        raise UndrawableError(f"the message has no array {path}")
    return value.raw, value.code
