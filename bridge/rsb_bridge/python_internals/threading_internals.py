"""The end of an interpreter's threads."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def before_waiting_for_threads(call: Callable[[], object]) -> None:
    """Have the interpreter call something before it waits for its threads, as concurrent.futures does.

    `atexit` comes after that wait, and is too late for what ends threads.
    """
    threading._register_atexit(call)  # type: ignore[attr-defined]
