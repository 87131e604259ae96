"""The parts of an engine: what answers commands and works beside the links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

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
        """Do the regular work, once a second, with the newest snapshot."""

    async def close(self) -> None:
        """End, before the links do: what it still sends has to cross them."""

    def join(self) -> None:
        """Wait for its threads, at the very end."""
