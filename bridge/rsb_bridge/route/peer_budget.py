"""The limits on the load that one peer causes here, over its whole link and as long as its routes live."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.keep import KEEP_BUDGET
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.message_check import CHECKED_A_SECOND, CHECKED_AT_ONCE, ExpansionBudget
from rsb_bridge.route.rate_limit import AllowedRates
from rsb_bridge.wire.framing import UNFINISHED_LIMIT, Budget

if TYPE_CHECKING:
    from rsb_bridge.ros.ros_interface import RosInterface

# Of one link. Where these were measured: bench/README.md, *Constants of a link's budgets*.
TYPES_PER_LINK = 256  # a robot with all of ROS's common packages has some 200
KEPT_LIMIT = 1 << 30  # bytes that its publishers keep: enough for 1,000 latched ones (`latched.PUBLISHER_COST`)
UNACKNOWLEDGED_LIMIT = 512 << 20  # bytes that they hold for slow subscribers; one topic gets half of that at most
WAITING_LIMIT = 64 << 20  # bytes that wait for a link that is away: a round figure
_FURTHER_PUBLISHERS = 256  # beyond one for each topic, which only loops of bridges need

PEERS_SHARE = 1.25  # of `CallLimits` on the providing side: calls end a little later there, and clocks differ
_LINGERS = 22.0  # s for which DDS holds what a stopped program does not take: it is given up after 20
_TOGETHER = 1.0  # s, of ended calls that are counted as one


class TypeBudget:
    """Limit on the types of one link's topics that are not installed here."""

    def __init__(self) -> None:
        self.limit = TYPES_PER_LINK
        self._users: Counter[tuple[str, str]] = Counter()

    @property
    def used(self) -> int:
        return len(self._users)

    def take(self, key: tuple[str, str]) -> None:
        """Count one more topic with a type.

        Raises:
            RosError: there are too many types; the message has the remedy.
        """
        if key not in self._users and len(self._users) >= self.limit:
            package = key[0].partition("/")[0]
            raise RosError(
                f"this link's topics have {self.limit} types that are not installed on this side, which is the limit: "
                f"install {package_of(package)} here, or remove topics"
            )
        self._users[key] += 1

    def give(self, key: tuple[str, str]) -> None:
        self._users[key] -= 1
        if not self._users[key]:
            del self._users[key]


class TypeUse:
    """The type of one topic's endpoints, while there are any."""

    def __init__(self, ros: RosInterface, budget: TypeBudget) -> None:
        self._ros = ros
        self._budget = budget
        self._key: tuple[str, str] | None = None

    def begin(self, type_name: str, type_hash: str, *, is_service: bool = False) -> None:
        """Count a type before its endpoints are created.

        Raises:
            RosError: the link's topics have too many types.
        """
        self.end()
        installed = self._ros.installed_service_hash if is_service else self._ros.installed_hash
        if installed(type_name) is None:
            self._budget.take((type_name, type_hash))
            self._key = (type_name, type_hash)

    def end(self) -> None:
        """Give the type back once all endpoints are closed. May be called twice."""
        if self._key is not None:
            self._budget.give(self._key)
            self._key = None


class CallLimits(NamedTuple):
    """Limits of one link's calls in one direction."""

    under_way: int = 4096  # calls that wait for their answers
    bytes_under_way: int = 256 << 20  # of these
    a_second: float = 5000.0  # and at once after a quiet second


CALL_LIMITS = CallLimits()


class CallBudget:
    """Limits on the calls of one link in one direction, over all its routes. Further calls are refused and never wait.

    Args:
        share: factor on the limits.
    """

    def __init__(self, now: float, limits: CallLimits = CALL_LIMITS, share: float = 1.0) -> None:
        self._calls = Budget(int(limits.under_way * share))
        self._bytes = Budget(int(limits.bytes_under_way * share))
        self._lingering: deque[tuple[float, int]] = deque()
        self._rate = TokenBucket(limits.a_second * share, limits.a_second * share, now)

    @property
    def held(self) -> tuple[int, int]:
        """Numbers of pending calls and of their bytes."""
        return self._calls.held, self._bytes.held

    def take(self, size: int, now: float) -> Refused | None:
        """Let a call of `size` bytes begin at `now` (s), or return the reason to refuse it."""
        if not self._rate.take(1.0, now):
            return Refused.TOO_FAST
        # Inline instead of `Budget.take`, because each call passes here on both sides.
        if self._calls.held >= self._calls.limit:
            return Refused.CALLS_UNDER_WAY
        lingering = self._lingers(now) if self._lingering else 0
        if self._bytes.held + size + lingering > self._bytes.limit:
            return Refused.BYTES_UNDER_WAY
        self._calls.held += 1
        self._bytes.held += size
        return None

    def change(self, before: int, size: int) -> bool:
        """Let a call hold `size` bytes instead of `before`; return False and change nothing if it may not."""
        held = self._bytes.held - before + size
        if held > self._bytes.limit:
            return False
        self._bytes.held = held
        return True

    def linger(self, size: int, now: float) -> None:
        """Count `size` bytes of an ended call that DDS holds from `now` (s) on for a server that may have stopped."""
        # Together, so that at 5,000 calls a second this holds some 20 entries and not 100,000.
        if self._lingering and now - self._lingering[-1][0] < _TOGETHER:
            began, before = self._lingering.pop()
            self._lingering.append((began, before + size))
        else:
            self._lingering.append((now, size))

    def _lingers(self, now: float) -> int:
        while self._lingering and now - self._lingering[0][0] > _LINGERS:
            self._lingering.popleft()
        return sum(size for _, size in self._lingering)

    def give(self, size: int) -> None:
        """Note the end of a call that held `size` bytes."""
        self._calls.held -= 1
        self._bytes.held -= size


class PeerBudget:
    """Limits on the memory and work that one peer causes here, over its whole link and as long as its routes live."""

    def __init__(self, now: float) -> None:
        self.unfinished = Budget(UNFINISHED_LIMIT)  # bytes of messages that are not whole yet
        self.kept = Budget(KEPT_LIMIT)  # bytes of messages that publishers here keep for late joiners
        self.unacknowledged = Budget(UNACKNOWLEDGED_LIMIT)  # bytes that they hold for slow subscribers
        self.expansion = ExpansionBudget(now)  # bytes by which compressed messages may grow here
        self.waiting = Budget(WAITING_LIMIT)  # bytes in the queues of its topics without `keep`
        self.keep = Budget(KEEP_BUDGET)  # bytes in the queues of topics with `keep` and no size of their own
        self.further_publishers = Budget(_FURTHER_PUBLISHERS)  # beyond one for each topic
        self.types = TypeBudget()  # that are not installed here
        self.rates = AllowedRates()  # of the peer's topics here
        self.asked = CallBudget(now, CALL_LIMITS)  # calls of this side's callers
        self.provided = CallBudget(now, CALL_LIMITS, PEERS_SHARE)  # calls of the peer's callers
        # Lengths to read for checks of the peer's messages.
        self.checks = TokenBucket(CHECKED_AT_ONCE, CHECKED_A_SECOND, now)
