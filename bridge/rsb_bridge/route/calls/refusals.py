"""Why a call has no answer, in the words that cross the link and that both sides count by."""

from __future__ import annotations

from enum import StrEnum


class Refused(StrEnum):
    """Why a call was refused, or given up on the other side. Counts are kept by these words, so they are stable."""

    CALLS_UNDER_WAY = "calls under way"
    """The link has as many as it may."""
    BYTES_UNDER_WAY = "bytes under way"
    """Likewise, of what calls and answers hold."""
    CALLS_A_SECOND = "calls a second"
    """More come than the link, the entry or the rights allow."""
    PAUSED = "paused"
    DISARMED = "disarmed"
    UNHEARD = "link silent"
    """It is armed, and the two sides have not heard each other for a second; an older peer reads `OTHER`."""
    PROVIDER_GONE = "provider gone"
    """Nobody serves it any more; the call reached nobody."""
    TOO_LARGE = "too large"
    """The request or the response is longer than a message may be."""
    MALFORMED = "malformed"
    """The request or the response is not one of its type; ROS did not get it."""
    TOO_COMPLEX = "too complex"
    """The request or the response has too many strings and sequences to check, or the link's calls have."""
    NOT_SENT = "not sent"
    """The middleware refused the request."""
    NOT_ARRIVED = "not arrived"
    """A goal was under way when the link went, never arrived, and does not begin late."""
    TOO_OLD = "too old"
    """The request was older than `max_age` when it would have been handed on; the call reached nobody."""
    LOST = "lost"
    """It was under way when its provider went. Counted as lost, not as refused."""
    OTHER = "other"
    """A newer peer's reason."""


REMEDIES = {
    Refused.CALLS_UNDER_WAY: "too many calls are under way on this link: make fewer at once, or shorten the timeout",
    Refused.BYTES_UNDER_WAY: "the calls under way on this link hold too many bytes: make fewer at once",
    Refused.CALLS_A_SECOND: "more calls a second are made than are allowed: call less often, or raise max_rate",
    Refused.PAUSED: "it is paused: resume it",
    Refused.DISARMED: "it was not armed when the request was made: ask again once it is armed",
    Refused.UNHEARD: "it is armed, but the two sides do not hear each other: ask again, or check the link",
    Refused.PROVIDER_GONE: "nobody serves it any more: start its node",
    Refused.TOO_LARGE: "the request or the response is longer than a message may be",
    Refused.MALFORMED: "the request or the response is malformed; the log of the side that got it says where",
    Refused.TOO_COMPLEX: "the link's calls have more strings and sequences than are checked: send less",
    Refused.NOT_SENT: "the middleware refused the request; the log of the providing side says why",
    Refused.NOT_ARRIVED: "the link dropped before the goal arrived, so it was not started: send it again",
    Refused.TOO_OLD: "the request was older than max_age: find what delays it, and ask again",
    Refused.LOST: "its server went while the call was under way, and may have acted on it",
    Refused.OTHER: "the other side gives a reason that this version does not know: update this side",
}
"""In words, for an operator."""


def refused_as(content: bytes) -> Refused:
    """What a peer's refusal says."""
    try:
        return Refused(content.decode())
    except ValueError:  # a UnicodeDecodeError is one, too
        return Refused.OTHER
