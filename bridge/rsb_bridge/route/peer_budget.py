"""What one peer can make this side hold and do, over its whole link."""

from __future__ import annotations

from rsb_bridge.model.token_bucket import TokenBucket
from rsb_bridge.route.calls.budget import PEERS_SHARE, CallBudget
from rsb_bridge.route.message_check import CHECKED_A_SECOND, CHECKED_AT_ONCE
from rsb_bridge.route.rate_limit import AllowedRates
from rsb_bridge.route.type_budget import TypeBudget
from rsb_bridge.route.unpacking import ExpansionBudget
from rsb_bridge.wire.framing import UNFINISHED_LIMIT, Budget

KEPT_LIMIT = 1 << 30
"""Bytes of messages that all publishers of a link keep together."""
UNACKNOWLEDGED_LIMIT = 512 << 20
"""Bytes of messages that all publishers of a link hold together for subscribers that are slow."""
_FURTHER_PUBLISHERS = 256


class PeerBudget:
    """One link's, for as long as its routes live.

    Attributes:
        unfinished: bytes of messages that are not whole yet.
        kept: bytes of messages that publishers here keep for late joiners.
        unacknowledged: bytes of messages that publishers here hold for slow subscribers.
        expansion: bytes by which compressed messages may grow here, over time and at once.
        further_publishers: how many the peer may have here beyond one a topic.
        types: that are not installed here.
        rates: of what the peer publishes here, by topic.
        asked: calls of this side's callers.
        provided: calls of the peer's callers.
        checks: lengths that are read to check the peer's messages.
    """

    def __init__(self, now: float) -> None:
        self.unfinished = Budget(UNFINISHED_LIMIT)
        self.kept = Budget(KEPT_LIMIT)
        self.unacknowledged = Budget(UNACKNOWLEDGED_LIMIT)
        self.expansion = ExpansionBudget(now)
        self.further_publishers = Budget(_FURTHER_PUBLISHERS)
        self.types = TypeBudget()
        self.rates = AllowedRates()
        self.asked = CallBudget(now)
        self.provided = CallBudget(now, PEERS_SHARE)
        self.checks = TokenBucket(CHECKED_AT_ONCE, CHECKED_A_SECOND, now)
