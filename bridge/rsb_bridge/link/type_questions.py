"""The two sides of a link tell each other what their messages' types consist of, when somebody looks at a message."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.questions import Questions
from rsb_bridge.wire.messages import AskType, TypeText

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from rsb_bridge.ros.type_descriptions import TypeDescriptions
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import ControlMessage

_ANSWERED_WITHIN = 10.0
"""s: the other side may have to ask several nodes."""


class TypeQuestions:
    """Asks the peer what a route's type is, and answers when it asks.

    Args:
        known: the descriptions that this side knows.
        open_route: gives a route by its id.
        send: sends a control message.
        spawn: runs a coroutine beside.
    """

    def __init__(
        self,
        known: TypeDescriptions,
        open_route: Callable[[int], Route | None],
        send: Callable[[ControlMessage], None],
        spawn: Callable[[Coroutine[None, None, None]], object],
    ) -> None:
        self._known = known
        self._open_route = open_route
        self._questions: Questions[bytes] = Questions(send, spawn, _ANSWERED_WITHIN)

    def disconnected(self) -> None:
        """The connection is over: nobody will answer."""
        self._questions.disconnected()

    def handle(self, message: AskType | TypeText) -> None:
        """Answer the peer's question, or take its answer."""
        match message:
            case AskType():
                self._questions.answer(message.route, partial(self._find, message.route))
            case TypeText():
                self._questions.answered(message.route, message.text)

    async def _find(self, route_id: int) -> TypeText:
        text = None
        route = self._open_route(route_id)
        if route is not None and route.type_hash:
            text = await self._known.find(route.type_name, route.type_hash, route.local_topic)
        return TypeText(route=route_id, text=zstandard.compress(text.encode()) if text else b"")

    async def describe(self, route: Route, *, linked: bool) -> str:
        """The text of the description of a route's type.

        Args:
            route: which.
            linked: whether the peer can be asked.

        Raises:
            LinkError: neither side knows it.
        """
        if not route.type_hash:
            raise LinkError("its type is not known yet" if not route.type_name else "its type's version is not known")
        text = await self._known.find(route.type_name, route.type_hash, route.local_topic)
        if text is None and linked and route.id:
            text = self._checked(await self._ask(route.id), route.type_hash)
        if text is None:
            raise LinkError(f"{route.type_name} is not installed on either side, and no node of the topic describes it")
        return text

    async def _ask(self, route_id: int) -> bytes:
        """The peer's answer; empty: it does not know, or does not answer."""
        try:
            return await self._questions.ask(route_id, AskType(route=route_id))
        except LinkError:
            return b""

    def _checked(self, compressed: bytes, type_hash: str) -> str | None:
        """The text in an answer, if it is that type's."""
        text = description_in(compressed)
        return text if text is not None and self._known.add(text, type_hash) else None


def description_in(compressed: bytes) -> str | None:
    """The text in an answer, whatever it describes; None: there is none."""
    try:
        size = zstandard.frame_content_size(compressed) if compressed else 0
        if not 0 < size <= DESCRIPTION_LIMIT:
            return None
        return zstandard.ZstdDecompressor().decompress(compressed).decode()
    except (zstandard.ZstdError, UnicodeDecodeError):
        return None
