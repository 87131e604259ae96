"""Codes of the history's events."""

from __future__ import annotations

from enum import StrEnum


class HistoryCode(StrEnum):
    CLOCK_SET = "engine.clock_set"
    """The wall clock jumped by more than 2 s."""
    GAP = "engine.gap"
    """The machine slept, or the process could not run."""
    FILE_FAILED = "log.file_failed"
    """The state folder cannot be written to; reported once."""
    FILE_AGAIN = "log.file_again"
    """The state folder can be written to again."""
    SET_ASIDE = "log.history_set_aside"
    """The file of the time line is damaged, or of another version."""
