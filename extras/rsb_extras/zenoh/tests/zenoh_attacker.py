"""Attacks on the bridges of a Zenoh network by somebody without a key, in a process of its own.

``python -m rsb_extras.zenoh.tests.zenoh_attacker ENDPOINT FLEET ATTACK HZ`` runs one until its standard input ends. It
then writes, as JSON, how many samples it has sent, and how many tokens it has declared.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import zenoh

from rsb_bridge.wire.preamble import PreambleKind
from rsb_extras.zenoh.sample_header import Header, SampleKind

TAG = bytes(16)
KEPT = 1000
"""Tokens at most that churn at a time."""


class Stranger:
    """Hears all that a router brings, and publishes under any key.

    Attributes:
        sent: counts of its attacks.
        streams: the newest header of each stream, by its key.
        tokens: keys of all tokens that were ever declared by others.
    """

    def __init__(self, endpoint: str, fleet: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/shared_memory/enabled", "false")
        self.session = zenoh.open(config)
        self.root = f"rsb_console/{fleet}"
        self.sent: Counter[str] = Counter()
        self.streams: dict[str, Header] = {}
        self.tokens: dict[str, None] = {}
        self.on_first: Callable[[str], None] = lambda _: None
        self._own: set[str] = set()
        self._heard = self.session.declare_subscriber(f"{self.root}/at/*/*/*", self._hear)
        self._seen = self.session.liveliness().declare_subscriber(f"{self.root}/here/**", self._see, history=True)

    def _hear(self, sample: Any) -> None:
        key = str(sample.key_expr)
        header = None if sample.attachment is None else Header.unpack(sample.attachment.to_bytes())
        if (
            header is None
            or header.kind != SampleKind.DATA
            or header.tag == TAG
            or b"forged" in sample.payload.to_bytes()
        ):
            return
        is_new = key not in self.streams and reverse(key) not in self.streams
        self.streams[key] = header
        if is_new and header.number == 0:
            self.on_first(key)

    def _see(self, sample: Any) -> None:
        key = str(sample.key_expr)
        if key not in self._own:
            self.tokens[key] = None

    def put(self, key: str, header: Header, payload: bytes) -> None:
        self.session.put(
            key,
            payload,
            attachment=header.pack(),
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self.sent["samples"] += 1

    def both(self, kind: SampleKind, number: Callable[[int], int], payload: bytes = b"") -> None:
        """Send a sample in both directions of each stream; the number is made of its newest one."""
        for key, newest in tuple(self.streams.items()):
            for each, known in ((key, newest.number), (reverse(key), self.streams.get(reverse(key), newest).number)):
                for tag in (b"", TAG):
                    self.put(each, Header(kind, newest.rank, number(known), tag), payload)

    def wait_until_heard(self) -> None:
        """Wait until the router knows what was declared: it answers a later question."""
        list(self.session.liveliness().get(f"{self.root}/here/**"))

    def close(self) -> None:
        """Leave the network."""
        self.session.close()  # type: ignore[no-untyped-call]

    def declare(self, key: str) -> Any:
        self._own.add(key)
        self.sent["tokens"] += 1
        return self.session.liveliness().declare_token(key)


def reverse(key: str) -> str:
    """The key of the other direction of a stream."""
    *root, to, sender, stream = key.rsplit("/", 3)
    return "/".join((*root, sender, to, stream))


def deletes(stranger: Stranger) -> None:
    """Declare the very tokens of others, and undeclare them."""
    for key in tuple(stranger.tokens):
        stranger.declare(key).undeclare()
        stranger.session.delete(key)


_churning: deque[Any] = deque()


def churn(stranger: Stranger) -> None:
    """Have servers and engines come and go."""
    for service, label in (("server", "fake"), ("engine", "client%200.1%20robot1")):
        _churning.append(stranger.declare(f"{stranger.root}/here/{service}/{os.urandom(8).hex()}/{label}"))
        if len(_churning) > KEPT:
            _churning.popleft().undeclare()


def answers(stranger: Stranger) -> None:
    """Answer each new stream at once, in its server's place: with a refusal, rubbish, a reset and an end."""
    refusal = b"\0\0\0\x10rsb\x01" + bytes([PreambleKind.REFUSE]) + b"\x01forged-12"

    def answer(key: str) -> None:
        back = reverse(key)
        for payload in (b"forged", refusal):
            stranger.put(back, Header(SampleKind.DATA, 0, 0), payload)
        stranger.put(back, Header(SampleKind.DATA, 0, 7), b"forged")
        stranger.put(back, Header(SampleKind.END, 0, 0), b"there is no such stream any more")
        stranger.put(key, Header(SampleKind.END, 0, 1), b"")
        stranger.put(key, Header(SampleKind.DATA, 0, 1), b"forged")

    stranger.on_first = answer


ATTACKS: dict[str, Callable[[Stranger], None]] = {
    "ends": lambda stranger: stranger.both(SampleKind.END, lambda newest: newest + 1),
    "first_ends": lambda stranger: stranger.both(SampleKind.END, lambda _: 0, b"there is no such stream any more"),
    "firsts": lambda stranger: stranger.both(SampleKind.DATA, lambda _: 0, b"forged"),
    "following": lambda stranger: stranger.both(SampleKind.DATA, lambda newest: newest + 1, b"forged"),
    "ahead": lambda stranger: stranger.both(SampleKind.DATA, lambda newest: newest + 1000, b"forged"),
    "windows": lambda stranger: stranger.both(SampleKind.WINDOW, lambda _: 2**62),
    "deletes": deletes,
    "churn": churn,
    "answers": answers,
}


class Attacker:
    """An attack in a process of its own, until `stop`."""

    def __init__(self, endpoint: str, attack: str, *, fleet: str = "fleet", hz: float = 20.0) -> None:
        command = [sys.executable, "-m", "rsb_extras.zenoh.tests.zenoh_attacker", endpoint, fleet, attack, str(hz)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "up\n"

    def stop(self) -> dict[str, int]:
        """End it, and return its counts."""
        said, _ = self._process.communicate(timeout=180)
        counts: dict[str, int] = json.loads(said)
        return counts

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def main() -> None:
    endpoint, fleet, attack, hz = sys.argv[1:]
    stranger = Stranger(endpoint, fleet)
    ended = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    ATTACKS[attack](stranger)
    stranger.wait_until_heard()
    sys.stdout.write("up\n")
    sys.stdout.flush()
    due = time.monotonic()
    while not ended.is_set():
        ATTACKS[attack](stranger)
        due = max(due + 1 / float(hz), time.monotonic() - 1.0)
        ended.wait(max(0.0, due - time.monotonic()))
    sys.stdout.write(json.dumps(stranger.sent))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
