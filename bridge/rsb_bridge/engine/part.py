"""Parts of an engine, which answer commands and work next to the links, and observers, which watch it from outside."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
    from concurrent.futures import Future

    from rsb_bridge.model.commands import Command
    from rsb_bridge.model.snapshot import Snapshot

    Handlers: TypeAlias = dict[type[Command[Any]], Callable[[Any], Coroutine[None, None, object]]]
    """Functions that execute commands, by the command's type. Each returns its command's result."""


class EnginePart:
    """A part that a feature adds. It belongs to the engine's I/O thread, and overrides what it needs.

    Attributes:
        handlers: execute commands, by the command's type.
        by_key: names of keys of the session, and what to do when a reload has changed one of them.
    """

    handlers: Handlers
    by_key: Sequence[tuple[tuple[str, ...], Callable[[], None]]] = ()

    def __init__(self) -> None:
        self.handlers = {}

    def open(self) -> None:
        """Begin, before the links do. May raise what `Bridge.start` takes for a reason not to start."""

    def tick(self, snapshot: Snapshot) -> None:
        """Do the regular work, once a second, with what `rsb_bridge.api.EngineApi.recorded` returns."""

    async def close(self) -> None:
        """End, before the links do: what it still sends has to cross them."""

    def join(self) -> None:
        """Wait for its threads, at the very end."""


class MovingPart(EnginePart, ABC):
    """A part that moves robots. Before it does, it asks `Bridge.may_move`."""

    @abstractmethod
    async def end_motions(self, topics: Collection[str] | None) -> bool:
        """Stop the robots that it moves on some topics, or on all, as that is about to become impossible.

        Returns:
            Whether it waited for anything.
        """


class EngineObserver:
    """A feature's observer of an engine, on threads of its own. It outlives the bridge, and overrides what it needs.

    It may read the engine's `log`, `snapshots.latest`, `clock` and `state` on any thread.

    Attributes:
        answers: answer commands on any thread, by the command's type, also while the I/O thread hangs.
    """

    answers: Mapping[type[Command[Any]], Callable[[Any], Future[Any]]] = {}

    def start(self) -> None:
        """Begin: the bridge has started."""

    def stop(self, timeout: float) -> None:
        """End, after the bridge.

        Args:
            timeout: within so many s, as far as it can.
        """
