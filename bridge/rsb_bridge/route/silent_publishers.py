"""Publishers of a latched topic that no new subscription hears, because they were killed.

DDS lists a killed publisher until its lease ends (Fast DDS: 20 s), but sends its history to no new subscription. So
when a new publisher comes, such as that of a restarted node, a further subscription shows which of the others answer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Subscription

_ASKED_AFTER = 0.3  # s: newcomers come together, as all do in a new opening
_OPENED_AGAIN_AFTER = 3.0  # s after it was refused: a round figure
_ANSWERED_WITHIN = 5.0
"""s after the newcomer's answer in which all others have to answer. They take milliseconds, on a busy machine up to
seconds. A publisher that answers later is heard again on the far side."""


class SilentPublishers:
    """Asks which publishers a late joiner would hear. It belongs to the I/O loop.

    Args:
        subscribe: subscribes once more, with a receiver of its messages; may raise RosError.
        judged: called when publishers have become silent.
        heard_again: gets the messages of publishers that were silent, and of the one that `hear_again` names.

    Attributes:
        silent: publishers that have not answered.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        subscribe: Callable[[Callable[[Sequence[RawMessage]], None]], Subscription],
        judged: Callable[[], None],
        heard_again: Callable[[Sequence[RawMessage]], None],
    ) -> None:
        self.silent: set[bytes] = set()
        self._loop = loop
        self._subscribe = subscribe
        self._judged = judged
        self._heard_again = heard_again
        self._newcomer = b""
        self._asked: set[bytes] = set()  # without an answer, and not silent yet
        self._wanted: set[bytes] = set()  # whose messages are heard again
        self._subscription: Subscription | None = None
        self._timer: asyncio.TimerHandle | None = None

    def ask(self, newcomer: bytes, others: Collection[bytes]) -> None:
        """Ask the other publishers; they are judged once the newcomer has answered."""
        self.close()
        self._newcomer, self._asked = newcomer, self._asked.union(others) - self.silent - {newcomer}
        self._timer = self._loop.call_later(_ASKED_AFTER, self._open)

    @property
    def asks(self) -> bool:
        """Whether publishers that are asked have not answered yet, nor are silent."""
        return bool(self._asked)

    def hear_again(self, publisher: bytes) -> bool:
        """Have one publisher's history sent once more, and return whether it will be."""
        self.close()
        self._open()
        if self._subscription is not None:
            self._wanted.add(publisher)
        return self._subscription is not None

    def forget_gone(self, present: Collection[bytes]) -> None:
        """Forget publishers that have ended."""
        for publishers in (self.silent, self._asked, self._wanted):
            publishers.intersection_update(present)
        self._close_if_answered()

    def go_on(self) -> None:
        """Ask and listen again, as before `close`."""
        if self.silent or self._asked or self._wanted:
            self.close()
            self._timer = self._loop.call_later(_ASKED_AFTER, self._open)

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None

    def _open(self) -> None:
        self._timer = None
        subscription: Subscription | None = None

        def take(batch: Sequence[RawMessage]) -> None:
            if subscription is self._subscription:  # else they were queued for a closed one
                self._take(batch)

        try:
            subscription = self._subscription = self._subscribe(take)
        except RosError:
            self._asked.clear()  # the next newcomer's messages ask again
            if self.silent or self._wanted:
                self._timer = self._loop.call_later(_OPENED_AGAIN_AFTER, self._open)

    def _take(self, batch: Sequence[RawMessage]) -> None:
        again = [each for each in batch if each.gid in self._wanted or each.gid in self.silent]
        answered = {each.gid for each in batch}
        self.silent -= answered
        self._asked -= answered
        if self._asked and self._newcomer in answered and self._timer is None:
            self._timer = self._loop.call_later(_ANSWERED_WITHIN, self._judge)
        if again:
            self._heard_again(again)
            self._wanted -= answered
        self._close_if_answered()

    def _judge(self) -> None:
        self._timer = None
        self.silent |= self._asked
        self._asked.clear()
        if self.silent:
            self._judged()

    def _close_if_answered(self) -> None:
        if not (self.silent or self._asked or self._wanted):
            self.close()
