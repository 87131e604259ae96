"""Stand-ins for the connection that hands control messages to the features of a link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.link.extension import Extension


def take(extension: Extension, message: Any) -> None:
    """Have an extension act on a message of the peer, and do at once what a link does in slices."""
    for _ in extension.messages[type(message)](message) or ():
        pass


class Handlers(dict[type, Any]):
    """One handler for messages of every type."""

    def __init__(self, handler: Callable[[Any], Any]) -> None:
        super().__init__()
        self._handler = handler

    def __missing__(self, _: type) -> Callable[[Any], Any]:
        return self._handler
