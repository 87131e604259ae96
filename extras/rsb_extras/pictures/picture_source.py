"""Where the pictures of a tile come from: one question to the engine after the other, each with the present wish."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import deque
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import Pixels, in_full

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rsb_console.feature_console import Console
    from rsb_extras.pictures.picture import Viewed, Wish

_RENEWED_AFTER = 0.15  # s; a round figure: eight such questions may be under way on a link with a round trip of 1.2 s
_IN_FULL_WITHIN = 5.0  # s. A round figure: an operator waits for the file
_COST_OVER = 5.0
"""s over which the cost of a tile is measured."""


class PictureSource:
    """The pictures of one viewer.

    Attributes:
        goes_on: is clear while the operator holds the picture.
    """

    def __init__(self, console: Console, link: str) -> None:
        self._console = console
        self._link = link
        self._viewer = secrets.token_hex(8)
        self.goes_on = asyncio.Event()
        self.goes_on.set()
        self._asked: Future[Viewed | None] | None = None
        self._renews = False
        self._sizes: deque[tuple[float, int]] = deque()
        """When pictures came lately, and their bytes."""

    async def next(self, topics: tuple[str, ...], wish: Wish) -> Viewed | None:
        """Return the next picture, or None if there is none yet; raise EngineError if there can be none.

        `ask_anew_soon` cancels it.
        """
        engine = self._console.engine
        if engine is None:
            raise EngineError("no session runs")
        self._asked = engine.do(LookAtTopics(self._viewer, topics, wish, self._link))
        viewed = await asyncio.wrap_future(self._asked)
        if viewed is not None and self.goes_on.is_set():
            self._sizes.append((time.monotonic(), viewed.encoded if viewed.where else 0))
        return viewed

    def end(self) -> None:
        """Ask for no more, at once, so that the next viewer finds room: there are few."""
        if (engine := self._console.engine) is not None:
            engine.do(EndLook(self._viewer))

    def ask_anew_soon(self) -> None:
        """Put the present wish in the place of the one that waits, so that a key has its effect at once.

        A key that is held changes the wish 30 times a second, and the other side answers only some questions at a time.
        """
        if self._asked is not None and not self._renews:
            self._renews = True
            asyncio.get_running_loop().call_later(_RENEWED_AFTER, self._ask_anew)

    def _ask_anew(self) -> None:
        self._renews = False
        if self._asked is not None:
            self._asked.cancel()

    @property
    def cost(self) -> float:
        """Bytes a second that it takes of a link."""
        now = time.monotonic()
        while self._sizes and now - self._sizes[0][0] > _COST_OVER:
            self._sizes.popleft()
        return sum(size for _, size in self._sizes) / _COST_OVER

    async def image_in_full(self, topics: tuple[str, ...], wish: Wish) -> Pixels | None:
        """Return the image that comes next in its own resolution, or None if none comes."""
        engine, viewer = self._console.engine, secrets.token_hex(8)
        if engine is None or not self.goes_on.is_set():
            return None
        try:
            async with asyncio.timeout(_IN_FULL_WITHIN):
                while True:
                    viewed = await asyncio.wrap_future(
                        engine.do(LookAtTopics(viewer, topics, in_full(wish), self._link))
                    )
                    if viewed is not None and isinstance(viewed.picture.content, Pixels):
                        return viewed.picture.content
                    if viewed is not None and viewed.picture.problem:
                        return None
        except (EngineError, TimeoutError):
            return None
        finally:
            engine.do(EndLook(viewer))
