"""Counts the calls that a function makes. A busy machine takes longer for them, and makes no more of them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

T = TypeVar("T")


def counted(act: Callable[[], T]) -> tuple[T, int]:
    """Return what a function returns, and how many functions were called for that, built-in ones included."""
    calls = 0

    def note(_: FrameType, event: str, __: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        return act(), calls
    finally:
        sys.setprofile(before)
