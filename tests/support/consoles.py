"""Consoles that keep armed what they have armed."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from tests.support.bridge import is_accepted, route
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine


class Consoles:
    """The consoles of engines, which give signs of life for the length of a test."""

    def __init__(self) -> None:
        self._engines: set[Engine] = set()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def arm(self, engine: Engine, topic: str = "/cmd", *, shared: bool = False) -> None:
        self._engines.add(engine)
        eventually(lambda: is_accepted(engine, topic))
        engine.arm(route(engine, topic).key, shared=shared).result(30)

    def _run(self) -> None:
        while not self._ended.wait(0.5):
            for engine in tuple(self._engines):
                engine.keep_armed(pressed=False)

    def close(self) -> None:
        """Give no further signs of life."""
        self._ended.set()
        self._thread.join()
