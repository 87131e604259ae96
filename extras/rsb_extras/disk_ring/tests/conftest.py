"""Surroundings of engines, commands and consoles, as in their own tests."""

from __future__ import annotations

from rsb_extras.recording.tests.conftest import (
    _answers_take_their_time,
    _parsed_once,
    _same_everywhere,
    _toasts_stay,
    consoles,
    folder,
    here,
    long_lease,
    loop,
    make_context,
    ran,
)

__all__ = [
    "_answers_take_their_time",
    "_parsed_once",
    "_same_everywhere",
    "_toasts_stay",
    "consoles",
    "folder",
    "here",
    "long_lease",
    "loop",
    "make_context",
    "ran",
]
