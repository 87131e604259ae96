"""Helpers of `test_churn` and others."""

from __future__ import annotations

import threading
from typing import Any


class Subscription:
    matched = 1

    def __init__(self, sink: Any) -> None:
        self.sink = sink
        self.delivering = threading.RLock()
        self.closed = False

    def close(self) -> None:
        with self.delivering:
            self.closed = True


class Publisher:
    subscriber_count, acknowledged = 1, True

    def __init__(self, gid: bytes, taken: list[bytes]) -> None:
        self.gid = gid
        self.publish = taken.append

    def close(self) -> None:
        pass
