"""A publisher that keeps a rate while a test looks elsewhere."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.publisher import Publisher


class Steady:
    """Publishes on a thread of its own, for the length of a `with`.

    Args:
        rate: Hz.
        message: makes a message of its number.
        catches_up: whether it publishes at once what a busy machine has kept it from publishing in time.

    Attributes:
        count: how many have been published.
        latest: s by which the latest one came too late, as this process got no processor.
    """

    def __init__(
        self, publisher: Publisher, rate: float, message: Callable[[int], bytes], *, catches_up: bool = False
    ) -> None:
        self.count = 0
        self.latest = 0.0
        self._publisher, self._pause, self._message, self._catches_up = publisher, 1 / rate, message, catches_up
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._over.wait(max(0.0, due - time.monotonic())):
            self.latest = max(self.latest, time.monotonic() - due)
            self._publisher.publish(self._message(self.count))
            self.count += 1
            due = (due if self._catches_up else time.monotonic()) + self._pause

    def __enter__(self) -> Steady:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
