"""A robot's own programs: talkers and listeners in one stock rclpy node, told over stdin what to do.

`python -m tests.network.node DOMAIN` takes a JSON object a line and answers each with one; `Node` is its other end.
Every message says its number and when it was published, and has a checksum.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.support.asked import Asked, answers
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.network.hosts import Host
    from tests.support.domain import Domain


class Heard(NamedTuple):
    """A message that came.

    Attributes:
        number: counts up from 1.
        sent: when it was published, ns since the epoch.
        came: when DDS received it, ns since the epoch.
    """

    number: int
    sent: int
    came: int

    @property
    def latency(self) -> float:
        """s."""
        return (self.came - self.sent) / 1e9


class Node(Asked):
    def __init__(self, host: Host, domain_id: int) -> None:
        command = sys.executable, "-m", "tests.network.node", str(domain_id)
        super().__init__(host.start(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE))

    def talk(
        self, topic: str, *, rate: float, size: int = 100, count: int | None = None, latched: bool = False
    ) -> None:
        """Publish, as soon as somebody listens.

        Args:
            rate: Hz.
            size: bytes, about.
            count: how many, or None until `hush`.
            latched: late joiners get the last one.
        """
        self.ask(do="talk", topic=topic, rate=rate, size=size, count=count, latched=latched)

    def said(self) -> dict[str, int]:
        """How many messages have been published, by topic."""
        said: dict[str, int] = self.ask(do="count")
        return said

    def hush(self) -> dict[str, int]:
        """Stop all talkers. Returns what each has `said`."""
        self.ask(do="hush")
        return self.said()

    def listen(self, *topics: str) -> None:
        """Subscribe, and wait for publishers."""
        for topic in topics:
            self.ask(do="listen", topic=topic)
        eventually(lambda: all(self.ask(do="matched", topic=topic) for topic in topics), what=f"published: {topics}")

    def heard(self, topic: str) -> list[Heard]:
        """All that came so far; AssertionError where a message is not as it was published."""
        return [Heard(*each) for each in self.ask(do="tell", topic=topic)]

    def hears(self, topic: str, within: float = 180.0, *, after: float | None = None) -> Heard:
        """Wait for a message published later than `after` (s since the epoch, now by default)."""
        after = time.time() if after is None else after

        def new() -> Heard | None:
            return next((each for each in self.heard(topic) if each.sent > after * 1e9), None)

        return eventually(new, within, f"anything new on {topic}")

    def close(self) -> None:
        self._process.communicate(timeout=60)


# --- the node's own process


class _Talker:
    def __init__(self, domain: Domain, topic: str, rate: float, size: int, count: int | None, *, latched: bool) -> None:
        from tests.support.domain import LATCHED, RELIABLE

        self.number = 0
        self.due = time.monotonic()
        self._publisher = domain.publisher(topic, qos=LATCHED if latched else RELIABLE)
        self._interval = 1 / rate
        self._size = size
        self._left = float("inf") if count is None else count

    def work(self) -> None:
        from tests.support.domain import text

        now = time.monotonic()
        if now < self.due:
            return
        self.due = max(self.due + self._interval, now)
        if self._left > 0 and self._publisher.get_subscription_count():
            self.number += 1
            self._left -= 1
            filler = random.Random(self.number).randbytes(self._size // 2).hex()
            checksum = zlib.crc32(filler.encode())
            self._publisher.publish(text(f"{self.number} {time.time_ns()} {checksum} {filler}"))


class _Ear:
    def __init__(self, domain: Domain, topic: str) -> None:
        self._listener = domain.listener(topic)
        self._heard: list[Heard] = []

    @property
    def matched(self) -> bool:
        """Whether somebody publishes."""
        return bool(self._listener.matched)

    def heard(self) -> list[Heard]:
        """All that came so far; ValueError where one is broken."""
        payloads, moments = self._listener.payloads, self._listener.received
        for index in range(len(self._heard), len(payloads)):
            # CDR: 4 bytes encapsulation, 4 length
            number, sent, checksum, filler = payloads[index][8:].rstrip(b"\0").split(b" ")
            if zlib.crc32(filler) != int(checksum):
                raise ValueError(f"message {number.decode()} has another checksum")
            self._heard.append(Heard(int(number), int(sent), moments[index]))
        return self._heard


def _main(domain_id: int) -> None:
    from tests.support.domain import Domain

    domain = Domain(domain_id)
    talkers: dict[str, _Talker] = {}
    ears: dict[str, _Ear] = {}

    def act(request: dict[str, Any]) -> object:
        match request.pop("do"):
            case "talk":
                talkers[request["topic"]] = _Talker(domain, **request)
            case "count":
                return {topic: talker.number for topic, talker in talkers.items()}
            case "hush":
                for talker in talkers.values():
                    talker.due = float("inf")
            case "listen":
                ears[request["topic"]] = _Ear(domain, request["topic"])
            case "matched":
                return ears[request["topic"]].matched
            case "tell":
                return ears[request["topic"]].heard()
        return None

    due = 0.0
    while answers(act, min(max(0.0, due - time.monotonic()), 0.1)):
        for talker in talkers.values():
            talker.work()
        due = min([talker.due for talker in talkers.values()], default=float("inf"))
    domain.close()


if __name__ == "__main__":
    _main(int(sys.argv[1]))
