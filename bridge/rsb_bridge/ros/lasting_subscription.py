"""A subscription that outlives its own failures."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import Backoff
from rsb_bridge.ros.ros_interface import Liveliness, RosError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.ros.ros_interface import OnFailure, Subscription

_FIRST_DELAY, _LONGEST_DELAY = 0.5, 30.0
"""s. Round figures: a subscription that fails at once costs an attempt each 30 s in the end."""
_APART = 0.5
"""s. Between two subscriptions of which the publisher is to notice that one has gone. A node that works for so long
when both changes come hears of them as of one, by which the number of its subscriptions has not changed."""
_HEALED_AFTER = 60.0
"""s after which a failure is a new one, with the first delay again: twice the longest delay."""


class LastingSubscription:
    """Subscribes again, after a delay that doubles, when the subscription fails. Belongs to the I/O loop.

    Attributes:
        failure: the reason why it takes no messages now, for operators, or an empty string.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        subscribe: Callable[[OnFailure], Subscription],
        changed: Callable[[], None],
    ) -> None:
        """Subscribe.

        Args:
            changed: called on the loop when `failure` has changed.

        Raises:
            RosError: the first attempt failed; it is not repeated.
        """
        self.failure = ""
        self._loop = loop
        self._subscribe = subscribe
        self._changed = changed
        self._backoff = Backoff(_FIRST_DELAY, _LONGEST_DELAY)
        self._opened_at = loop.time()
        self._retry: asyncio.TimerHandle | None = None
        self._subscription: Subscription | None = self._open()

    @property
    def matched(self) -> int:
        """How many publishers DDS has matched with it; 0 after a failure."""
        return self._subscription.matched if self._subscription is not None else 0

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a publisher for a policy that the graph does not show."""
        return self._subscription is not None and self._subscription.refuses

    @property
    def liveliness(self) -> Liveliness:
        """The liveliness of its publishers; only asked if the QoS has a lease."""
        return self._subscription.liveliness if self._subscription is not None else Liveliness()

    def reopen(self) -> None:
        """Subscribe again; if that fails, retry later."""
        if self._subscription is not None:
            self._drop()
            self._try_again()

    def renew(self) -> None:
        """Subscribe anew, so that publishers see a new subscription after none, unless it has failed."""
        if self._subscription is not None:
            self._drop()
            self._retry = self._loop.call_later(_APART, self._try_again)

    def close(self) -> None:
        """Take no more messages. May be called twice."""
        self._drop()
        if self._retry is not None:
            self._retry.cancel()

    def _open(self) -> Subscription:
        subscription: Subscription | None = None

        def failed(error: RosError) -> None:  # on the ROS thread
            with contextlib.suppress(RuntimeError):  # the loop is closed: the engine has stopped
                # Read on the loop: it may fail before `subscribe` has returned it.
                self._loop.call_soon_threadsafe(lambda: self._failed(subscription, str(error)))

        subscription = self._subscribe(failed)
        self._opened_at = self._loop.time()
        return subscription

    def _failed(self, subscription: Subscription | None, reason: str) -> None:
        # `reopen` may have replaced it since it failed.
        if subscription is not None and subscription is self._subscription:
            self._drop()
            if self._loop.time() - self._opened_at >= _HEALED_AFTER:
                self._backoff.reset()
            self._try_later(reason)

    def _drop(self) -> None:
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None

    def _try_later(self, reason: str) -> None:
        self.failure = reason
        self._retry = self._loop.call_later(self._backoff.next(), self._try_again)
        self._changed()

    def _try_again(self) -> None:
        self._retry = None
        try:
            self._subscription = self._open()
        except RosError as error:
            self._try_later(str(error))
        else:
            if self.failure:
                self.failure = ""
                self._changed()
