"""Listens at the far end of a topic, in this process, and checks what arrives."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String
from tests.soak.messages import Kind, decode
from tests.support.domain import BEST_EFFORT, RELIABLE, Domain

_LATCHED = QoSProfile(depth=100, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class TopicListener:
    """Listens to one topic.

    Attributes:
        name: the topic's name on the server, in either direction, such as ``robot1/scan``.
        flowed_at: s since the epoch, when the first message came that was published after `expect`'s moment.
    """

    def __init__(self, name: str, domain: Domain, topic: str, kind: Kind) -> None:
        self.name = name
        self.kind = kind
        self.heard = 0
        self.wrong: list[str] = []
        self.flowed_at: float | None = None
        self._expected = 0.0
        self._newest: dict[int, int] = {}
        qos = _LATCHED if kind.latched else BEST_EFFORT if kind.best_effort else RELIABLE
        self._domain = domain
        self._subscription = domain.node.create_subscription(String, topic, lambda _: None, qos, raw=True)

    @property
    def newest(self) -> int:
        return self._newest[max(self._newest)] if self._newest else 0

    def expect(self, moment: float) -> None:
        """Wait for a message published after `moment` (s since the epoch)."""
        self._expected = moment
        self.flowed_at = None

    def close(self) -> None:
        self._domain.node.destroy_subscription(self._subscription)

    def take(self, clock: Callable[[], float]) -> None:
        """Take what has come; `clock` gives s since the epoch."""
        handle = self._subscription.handle
        while (taken := handle.take_message(String, True)) is not None:
            self.heard += 1
            message = decode(taken[0])
            if not message.whole:
                self.wrong.append(f"{self.name}: a message came damaged")
                continue
            if self.flowed_at is None and message.sent > self._expected:
                self.flowed_at = clock()
            newest = self._newest.get(message.life, 0)
            if message.number <= newest and self.kind.protocol == "tcp" and not self.kind.latched:
                self.wrong.append(f"{self.name}: message {message.number} came after {newest}, over TCP")
            self._newest[message.life] = max(newest, message.number)
            while len(self._newest) > 4:
                del self._newest[next(iter(self._newest))]
