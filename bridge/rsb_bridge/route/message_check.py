"""Checks a peer's messages, requests and responses against their types before ROS gets them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.checker import STEPS, MalformedError, TooComplexError
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable

    from rsb_bridge.cdr.checker import Checker
    from rsb_bridge.context import Context
    from rsb_bridge.model.token_bucket import TokenBucket
    from rsb_bridge.ros.ros_interface import Endpoint

CHECKED_AT_ONCE = 2 * STEPS
CHECKED_A_SECOND = 2 * STEPS
"""Lengths in sequences that are read of one link's messages: a tenth to a fifth of the time of the I/O loop."""
_LOOKS_AGAIN_AFTER = 10.0
"""s until the nodes of a topic are asked again for the description of its type."""
_EXPLAINED = 4
"""A malformed message costs about as much as so many others, as it is read again for the field that shows it."""
_REMEDY = "send less, or set check_messages: false"


def malformed_text(type_name: str, peer: str, error: MalformedError) -> str:
    """Describe a malformed message for an operator; the texts of one type are as many as its fields."""
    return f"malformed {type_name} from {peer}: {error}: see the node there that sent it"


class MessageCheck:
    """The check of one topic's messages, or of one service's requests or responses.

    Args:
        context: has the session, and the checkers.
        budget: of the link, for lengths that are read.

    Attributes:
        checker: of the type, or None if messages are not checked.
        type_name: that messages are checked against, or an empty string.
    """

    def __init__(self, context: Context, budget: TokenBucket) -> None:
        self.checker: Checker | None = None
        self._context = context
        self._budget = budget
        self.type_name = ""
        self._looks_at = float("-inf")
        self._looking: asyncio.Task[None] | None = None

    def begin(self, type_name: str) -> None:
        """Check messages of a type from now on, if it is described on this side."""
        self.end()
        self.type_name = type_name
        if self._context.session.check_messages and type_name:
            self.checker = self._context.checkers.installed(type_name)

    def end(self) -> None:
        """Check nothing."""
        self.checker = None
        self.type_name = ""
        self._looks_at = float("-inf")
        if self._looking is not None:
            self._looking.cancel()
            self._looking = None

    def set(self) -> None:
        """Take over `check_messages` of the session."""
        self.begin(self.type_name)

    def look(self, topic: str, endpoints: Iterable[Endpoint]) -> None:
        """Ask the nodes that subscribe to a topic for the description of a type that is not installed here.

        This may be called often.

        Args:
            topic: its name here.
            endpoints: its subscriptions.
        """
        context = self._context
        if self.checker is not None or self._looking is not None or not self.type_name:
            return
        if not context.session.check_messages or context.now() < self._looks_at:
            return
        hashes = [each.type_hash for each in endpoints if each.type_name == self.type_name and each.type_hash]
        if hashes and context.ros.installed_hash(self.type_name) is None:
            self._looks_at = context.now() + _LOOKS_AGAIN_AFTER
            self._looking = context.loop.create_task(self._ask(self.type_name, hashes[0], topic))

    async def _ask(self, type_name: str, type_hash: str, topic: str) -> None:
        try:
            self.checker = await self._context.checkers.find(type_name, type_hash, topic)
        except RosError:
            pass  # the messages stay unchecked until the next look
        finally:
            self._looking = None

    def check(self, payload: bytes) -> None:
        """Check a message.

        Raises:
            MalformedError: it does not fit its type.
            TooComplexError: it has too many lengths, or the link's messages have.
        """
        checker = self.checker
        if checker is None:
            return
        try:
            if not checker.loops:
                checker.check(payload)
                return
            now = self._context.now()
            if min(len(payload) // 4, STEPS) > self._budget.left(now):  # each length takes four bytes
                raise TooComplexError(
                    f"this link's messages have more than {CHECKED_A_SECOND:,} strings and sequences a second"
                )
            steps = checker.check(payload)
        except MalformedError as error:
            now = self._context.now()
            self._budget.take(min(_EXPLAINED * error.steps, self._budget.left(now)), now)
            raise
        except TooComplexError as error:
            raise TooComplexError(f"{error}, the most that are checked: {_REMEDY}") from None
        if steps:
            self._budget.take(steps, now)
