"""Codes of the ring's events, and what it says."""

from __future__ import annotations

from enum import StrEnum

from rsb_bridge.feature_api import Wording


class RingCode(StrEnum):
    KEPT = "ring.kept"
    NOT_KEPT = "ring.not_kept"
    REMOVED = "ring.removed"
    RECOVERED = "ring.recovered"
    LOST = "ring.lost"
    STOPPED = "ring.stopped"
    GOES_ON = "ring.goes_on"
    UNREAD = "ring.unread"
    """A kept stretch has a file that cannot be read."""


class RingText(Wording):
    KEPT = "{messages:,} messages of {topics} topics, {seconds:.0f} s, kept in {path} ({reason})"
    KEPT_CUT = "{messages:,} messages of {topics} topics, {seconds:.0f} s, of before the bridge ended, kept in {path}"
    FULL = "not kept ({reason}): with what operators kept in {folder} it exceeds record.kept, {size:g} GB: move some"
    NOT_KEPT = "not kept ({reason}): {folder}: {error}"
    REMOVED = "{path} removed ({reason}), the oldest that no operator has kept: record.kept is {size:g} GB"
    RECOVERED = "{path} was cut: {messages:,} messages are whole, {lost:,} bytes behind them are lost"
    LOST = "{count:,} messages are not in {folder}: the disk is too slow, or the bridge too busy"
    STOPPED = "nothing is written to {folder}: {error}"
    GOES_ON = "the ring is written again; {count:,} messages are missing"
    UNREAD = "{path} lacks the messages of a file, which cannot be read: {reason}"
    NO_SPACE = "less than {free:g} GB of its disk are free: free some, or lower record.free"


class RingProblem(Wording):
    """The reason why nothing is kept."""

    OFF = "there is no ring on disk: set record: {{disk: 2}} in the bridge's session file, and reload it"
    NOT_WRITTEN = "nothing is written to the ring now: the log says why (ring.stopped)"
