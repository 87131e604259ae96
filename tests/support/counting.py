"""Messages counted outside of the bridge: a publisher, a listener and both bridges are processes of their own.

`python -m tests.support.counting publish|listen DOMAIN TOPIC DEPTH` is a publisher or a listener, which answers each
line of its input with its count so far.
"""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from tests.support.asked import Asked, answers
from tests.support.forker import Forked
from tests.support.ports import free_port
from tests.support.program import Programs
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.text import keep_output_clean

TOPIC = "/count"
_QUIET = 1.3
"""s in which no count changes before it is taken as final."""


class Count(NamedTuple):
    """A run's figures.

    Attributes:
        received: different messages that the listener got.
        doubled: messages that it got more than once.
        gaps: runs of messages that it did not get, by length, the longest first.
        ledger: of the sending side, as ``status --json`` has it.
    """

    published: int
    received: int
    doubled: int
    gaps: list[int]
    ledger: dict[str, Any]

    @property
    def never_taken(self) -> int:
        """Messages that nobody was there to take: the route was down."""
        taken: int = self.ledger["offered"] + self.ledger["lost_in_dds"]
        return self.published - taken

    @property
    def ended(self) -> int:
        """Messages of which the ledger says that they did not arrive."""
        ended: int = sum(self.ledger["dropped"].values()) + self.ledger["throttled"] + self.ledger["expired"]
        return ended

    def __str__(self) -> str:
        names = ("offered", "delivered", "expired", "dropped", "unknown", "waiting", "in_flight", "lost_in_dds")
        figures = {name: self.ledger[name] for name in (*names, "missed_while_down", "unsubscribed")}
        return f"{self.published} published, {self.never_taken} never taken, {self.received} received; {figures}"


def _counter(*arguments: object) -> Asked:
    words = map(str, arguments)
    return Asked(Forked("tests.support.counting", *words, stdin=subprocess.PIPE, stdout=subprocess.PIPE))


class _Bridge:
    """`rsb-console run`, which prints its status ten times a second."""

    def __init__(self, folder: Path, session: Session) -> None:
        self._programs, self._session = Programs(folder), session
        self._environ = {"XDG_STATE_HOME": str(folder / session.role)}
        self.close = self._programs.close
        self.start()

    def start(self) -> None:
        self.program = self._programs.start(self._session, "--status-every", "0.1", environ=self._environ)

    def topic(self) -> dict[str, Any] | None:
        """Return the topic of the newest status, or None before the first status."""
        for line in reversed(self.program.output.splitlines(keepends=True)):
            if line.startswith("{") and line.endswith("}\n"):
                found = json.loads(line)
                for route in found.get("status", {}).get("routes", ()):
                    if route["topic"].endswith(TOPIC):
                        return dict(route)
        return None


class CountedBridge:
    """A bridge of one topic from the client's domain to the server's.

    Args:
        domains: the client's, and the server's.
        topic: its entry in the client's session.
        depth: of the publisher and the listener.
        address: that the server listens at, and that the client calls.
        settings: of both sessions, instead of the usual ones.
    """

    def __init__(
        self,
        folder: Path,
        domains: tuple[int, int],
        topic: Topic,
        *,
        depth: int = 5000,
        address: tuple[str, str] = ("127.0.0.1", "127.0.0.1"),
        port: int = 0,
        settings: dict[str, Any] | None = None,
    ) -> None:
        self.port = port or free_port()
        write_key(folder / "key.txt")
        common: dict[str, Any] = {"name": "robot1", "server_port": self.port, "key_file": "key.txt"}
        sides = {
            "server": {"domain_id": domains[1], "server_ip": address[0]},
            "client": {"domain_id": domains[0], "server_ip": address[1], "topics": (topic,)},
        }
        self.listener = _counter("listen", domains[1], TOPIC, depth)
        self.publisher = _counter("publish", domains[0], TOPIC, depth)
        self.server, self.client = (
            _Bridge(folder, Session(**{**common, "role": role, **fields, **(settings or {})}))
            for role, fields in sides.items()
        )

    def __enter__(self) -> CountedBridge:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for each in (self.server, self.client, self.listener, self.publisher):
            each.close()

    def flows(self, rate: float) -> None:
        """Publish at `rate` Hz from now on; wait until more comes."""
        eventually(
            lambda: self.publisher.ask()["matched"] and self.listener.ask()["matched"],
            what=f"both ends; the client says {self.client.program.output[-3000:]}",
        )
        before = self.listener.ask()["heard"]
        self.publisher.ask(rate=rate)
        eventually(
            lambda: self.listener.ask()["heard"] > before + 5,
            what=f"messages; the client says {self.client.program.output[-999:]}",
        )

    def freeze(self, seconds: float) -> None:
        """Stop the receiving bridge for some time."""
        self.server.program.signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.server.program.signal(signal.SIGCONT)

    def restart(self, after: float = 0.0) -> float:
        """Kill the receiving bridge, and start it again. Return the time (s, monotonic) of its death."""
        self.server.program.kill()
        killed_at = time.monotonic()
        time.sleep(after)
        self.server.start()
        return killed_at

    def settled(self) -> Count:
        """Stop publishing; the counts once they change no more."""
        published = self.publisher.ask(rate=0.0)["published"]
        last: Any = None
        since = time.monotonic()

        def quiet() -> Any:
            nonlocal last, since
            heard, topic = self.listener.ask(), self.client.topic()
            assert topic is not None
            now = (heard, topic["offered"], topic["delivered"], topic["dropped"], topic["waiting"], topic["in_flight"])
            if now != last or topic["waiting"] or topic["in_flight"]:
                last, since = now, time.monotonic()
            return (heard, topic) if time.monotonic() - since > _QUIET else None

        heard, topic = eventually(quiet, what=f"a settled ledger; the last was {last}")
        return Count(published, heard["heard"], heard["doubled"], self.listener.ask(gaps=True), topic)


def _publish(domain_id: int, topic: str, depth: int) -> None:
    from rclpy.qos import QoSProfile
    from tests.support.domain import Domain, text

    domain = Domain(domain_id)
    publisher = domain.publisher(topic, qos=QoSProfile(depth=depth))
    count, rate, due = 0, 0.0, time.monotonic()

    def act(request: dict[str, Any]) -> object:
        nonlocal rate, due
        if "rate" in request:
            rate, due = request["rate"], time.monotonic()
        return {"published": count, "matched": publisher.get_subscription_count()}

    while answers(act, max(0.0, due - time.monotonic()) if rate else 1.0):
        while rate and due <= time.monotonic():
            publisher.publish(text(f"{count}"))
            count += 1
            due += 1 / rate


def _listen(domain_id: int, topic: str, depth: int) -> None:
    from rclpy.qos import QoSProfile
    from tests.support.domain import Domain

    domain = Domain(domain_id)
    listener = domain.listener(topic, qos=QoSProfile(depth=depth))
    heard: set[str] = set()
    doubled, newest = 0, -1

    def act(request: dict[str, Any]) -> object:
        if "gaps" in request:
            numbers = sorted(map(int, heard))
            lengths = [after - before - 1 for before, after in itertools.pairwise([-1, *numbers])]
            return sorted(filter(None, lengths), reverse=True)
        return {"heard": len(heard), "doubled": doubled, "newest": newest, "matched": listener.matched}

    while answers(act, 0.001):
        count = len(listener.payloads)  # takes what has come
        words = listener.texts(count) if count else []
        listener.forget()
        doubled += len(words) - len(set(words) - heard)
        heard.update(words)
        newest = max(newest, *map(int, words)) if words else newest


if __name__ == "__main__":
    keep_output_clean()
    {"publish": _publish, "listen": _listen}[sys.argv[1]](int(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
