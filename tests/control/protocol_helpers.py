"""Helpers of `test_protocol` and others."""

from __future__ import annotations

from typing import Any

from rsb_bridge.control import protocol


def fed(data: bytes, *, to_bridge: bool, at_once: int = 1 << 20) -> list[Any]:
    frames: protocol.Frames[Any] = protocol.frames_to_bridge() if to_bridge else protocol.frames_to_console()
    return [each for at in range(0, len(data), at_once) for each in frames.feed(data[at : at + at_once])]
