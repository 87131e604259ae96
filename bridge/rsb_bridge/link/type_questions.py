"""The two sides of a link tell each other what their messages' types consist of, when somebody looks at a message."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT
from rsb_bridge.link.errors import LinkError
from rsb_bridge.wire.messages import AskType, ControlMessage, TypeText

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from rsb_bridge.ros.type_descriptions import TypeDescriptions
    from rsb_bridge.route.route import Route

_ANSWER_WITHIN = 10.0
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
        self._send = send
        self._spawn = spawn
        self._asked: dict[int, asyncio.Future[bytes]] = {}
        self._answering = False

    def disconnected(self) -> None:
        """The connection is over: nobody will answer."""
        for future in self._asked.values():
            if not future.done():
                future.set_result(b"")
        self._asked.clear()

    def handle(self, message: AskType | TypeText) -> None:
        """Answer the peer's question, or take its answer."""
        match message:
            case AskType() if not self._answering:
                self._answering = True
                self._spawn(self._answer(message.route))
            case AskType():
                pass  # one at a time: the answer costs more than the question
            case TypeText():
                future = self._asked.get(message.route)
                if future is not None and not future.done():
                    future.set_result(message.text)

    async def _answer(self, route_id: int) -> None:
        text = None
        try:
            route = self._open_route(route_id)
            if route is not None and route.type_hash:
                text = await self._known.find(route.type_name, route.type_hash, route.local_topic)
        finally:
            self._answering = False
        self._send(TypeText(route=route_id, text=zstandard.compress(text.encode()) if text else b""))

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
        future = self._asked.get(route_id)
        if future is None:
            future = self._asked[route_id] = asyncio.get_running_loop().create_future()
            self._send(AskType(route=route_id))
        try:
            async with asyncio.timeout(_ANSWER_WITHIN):
                return await asyncio.shield(future)
        except TimeoutError:
            return b""
        finally:
            if self._asked.get(route_id) is future:
                del self._asked[route_id]

    def _checked(self, compressed: bytes, type_hash: str) -> str | None:
        """The text in an answer, if it is that type's."""
        try:
            size = zstandard.frame_content_size(compressed) if compressed else 0
            if not 0 < size <= DESCRIPTION_LIMIT:
                return None
            text = zstandard.ZstdDecompressor().decompress(compressed).decode()
        except (zstandard.ZstdError, UnicodeDecodeError):
            return None
        return text if self._known.add(text, type_hash) else None
