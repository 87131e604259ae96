"""Attackers that have a client's key: they are linked as ``rogue``."""

from __future__ import annotations

import contextlib
import threading
import time
from itertools import count
from typing import TYPE_CHECKING

import msgspec
import zstandard
from bench.attacks.target import Attack, paced
from tests.support.frames import write_frame
from tests.support.rogue import Rogue

from rsb_bridge.cdr.known_types import STRING_HASH
from rsb_bridge.model.limits import ROUTES_PER_LINK, dds_ports
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.wire.framing import ZSTD
from rsb_bridge.wire.messages import (
    Accept,
    Amend,
    AskType,
    Close,
    Describe,
    ListTopics,
    Pause,
    Ping,
    Propose,
    Ready,
    Refuse,
    Report,
)
from rsb_bridge.wire.records import ReceivedCounts, SentCounts, Source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from bench.attacks.target import Tally, Target

    from rsb_bridge.wire.messages import ControlMessage

HOARD = "/hoard"
"""A topic of the server's domain with a subscriber that is stopped."""
_STRING = ("std_msgs/msg/String", STRING_HASH)
_EVIL = "\x1b]0;evil\x07\x1b[2J\u202eevil\u200b\n2026-01-01 00:00:00 INFO forged line\r"


def _rogue(target: Target) -> Rogue:
    return Rogue(target.port, target.key, "rogue", host=target.host)


def _flood(
    target: Target,
    tally: Tally,
    what: str,
    messages: Callable[[Rogue], Iterable[ControlMessage]],
    *,
    reads: bool = True,
) -> None:
    """Say messages as fast as the server takes them, a hundred at once; link again when the link is lost."""
    while True:
        with contextlib.suppress(OSError, AssertionError), _rogue(target) as rogue:
            tally["links"] += 1
            if not reads:
                rogue.takes_little()
            batch: list[ControlMessage] = []
            for message in messages(rogue):
                batch.append(message)
                if len(batch) == 100:
                    rogue.say(*batch)
                    tally[what] += len(batch)
                    batch.clear()
        time.sleep(0.05)


def _drained(rogue: Rogue) -> Rogue:
    threading.Thread(target=rogue.drain, daemon=True).start()
    return rogue


def pings(target: Target, tally: Tally) -> None:
    _flood(target, tally, "pings", lambda _: (Ping(n, 0) for n in count()), reads=False)


def proposals(target: Target, tally: Tally) -> None:
    def propose(rogue: Rogue) -> Iterable[ControlMessage]:
        _drained(rogue)
        for number in count():
            name = f"/proposed{number}"
            yield Propose(route=2 * number + 1, topic=name, remote_topic=name, from_client=True)

    _flood(target, tally, "proposals", propose)


def control(target: Target, tally: Tally) -> None:
    def say(rogue: Rogue) -> Iterable[ControlMessage]:
        route = rogue.route("/amended", "tcp", Qos())
        _drained(rogue)
        for number in count():
            yield Amend(route, max_rate=1.0 + number % 100)

    _flood(target, tally, "messages", say)


def pauses(target: Target, tally: Tally) -> None:
    def say(rogue: Rogue) -> Iterable[ControlMessage]:
        route = rogue.route("/paused", "tcp", Qos())
        _drained(rogue)
        for number in count():
            yield Pause(route, number % 2 == 0, number + 1, "nobody")

    _flood(target, tally, "pauses", say)


def questions(target: Target, tally: Tally) -> None:
    def ask(rogue: Rogue) -> Iterable[ControlMessage]:
        route = rogue.route("/asked", "tcp", Qos(durability="transient_local"))
        _drained(rogue)
        for number in count():
            yield ListTopics(number) if number % 2 else AskType(route)

    _flood(target, tally, "questions", ask)


def oversize(target: Target, tally: Tally) -> None:
    causes = {f"cause_{number:04}": number for number in range(32)}
    # 0.8 MB of the 1 MiB that is the limit of a control message.
    sent, received = SentCounts(route=1, dropped=causes), ReceivedCounts(route=1, dropped=causes)
    large = Report(sent_counts=(sent,) * ROUTES_PER_LINK, received_counts=(received,) * ROUTES_PER_LINK)

    def say(rogue: Rogue) -> Iterable[ControlMessage]:
        _drained(rogue)
        while True:
            rogue.say(large)
            tally["MB"] += 1
            yield Ping(1, 0)

    _flood(target, tally, "messages", say)


def reconnects(target: Target, tally: Tally) -> None:
    while True:
        with contextlib.suppress(OSError, AssertionError), _rogue(target):
            tally["links"] += 1


def bombs(target: Target, tally: Tally) -> None:
    """Messages of 60 MB that are some kB on the wire."""
    # Just below 64 MiB, the limit of a message.
    bomb = zstandard.ZstdCompressor(1).compress(bytes(60_000_000))
    with _rogue(target) as rogue:
        stream, writer = rogue.stream(rogue.route("/bomb", "tcp", Qos()))
        _drained(rogue)
        while True:
            stream.sendall(write_frame(writer, bomb, 0, ZSTD))
            tally["bombs"] += 1


def ports(target: Target, tally: Tally) -> None:
    first = int(dds_ports(target.domain).low)
    reserved = range(first, first + 64)
    with _rogue(target) as rogue:
        for port in [*reserved, *range(5000, 5064)]:
            number = rogue.new_route()
            name = f"/port{port}"
            rogue.say(
                Propose(route=number, topic=name, remote_topic=name, from_client=True, transport="udp", port=port)
            )
            answer = rogue.wait_for(Accept, Refuse)
            kind = "reserved ports" if port in reserved else "ports"
            tally[f"{kind} {'bound' if isinstance(answer, Accept) else 'refused'}"] += 1
        rogue.drain()


def routes(target: Target, tally: Tally) -> None:
    """Open as many routes with streams as the server takes, and keep them open."""
    with _rogue(target) as rogue:
        try:
            for number in range(5000):
                rogue.route(f"/route{number}", "tcp", Qos())
                rogue.say(Ping(number, 0))
                tally["streams"] += 1
        except (OSError, AssertionError):
            tally["refused in the end"] += 1
        _drained(rogue)
        for number in paced(1):
            rogue.say(Ping(number, 0))


def types(target: Target, tally: Tally) -> None:
    """Types that nobody has, known by name alone; each route is closed again."""
    with _rogue(target) as rogue:
        for number in count():
            route, name = rogue.new_route(), f"/type{number % 100}"
            rogue.say(Propose(route=route, topic=name, remote_topic=name, from_client=True))
            if not isinstance(rogue.wait_for(Accept, Refuse), Accept):
                tally["types refused"] += 1
                continue
            kind = (f"made_up_msgs/msg/Blob{number}", f"RIHS01_{number:064x}")
            rogue.say(Describe(route, *kind, qos=Qos(), sources=(Source((f"rsb_rogue{name}",)),)))
            tally["types" if isinstance(rogue.wait_for(Ready, Refuse), Ready) else "types refused"] += 1
            rogue.say(Close(route, "done", EndCode.REMOVED))


def volatile(target: Target, tally: Tally) -> None:
    """Fill a deep volatile history for a stopped subscriber."""
    with _rogue(target) as rogue:
        stream, writer = rogue.stream(rogue.route(HOARD, "tcp", Qos(depth=100_000), _STRING))
        _drained(rogue)
        threading.Thread(target=_keep_alive, args=(rogue,), daemon=True).start()
        content = b"\x00\x01\x00\x00" + (1 << 16).to_bytes(4, "little") + b"x" * ((1 << 16) - 1) + b"\0"
        # Nearly thrice the 512 MiB that a server keeps for slow subscribers of a link (docs/budgets.md).
        while tally["MB"] < 1500:
            stream.sendall(b"".join(write_frame(writer, content, 0) for _ in range(16)))
            tally["MB"] += 1
            time.sleep(0.004)
        # The link has to stay up, since the server drops all that it keeps for a link that ends.
        time.sleep(3600)


def _keep_alive(rogue: Rogue) -> None:
    for number in paced(1):
        rogue.say(Ping(number, 0))


def escapes(target: Target, tally: Tally) -> None:
    """Send escape sequences and forged lines in all fields that the server may quote."""
    texts: list[dict[str, object]] = [
        {"message": _EVIL},
        {"message": "shutdown", "reason": _EVIL},
        {"message": "propose", "route": 1, "topic": _EVIL, "remote_topic": "/x", "from_client": True},
        {"message": "propose", "route": 1, "topic": "/x", "remote_topic": "/x", "from_client": _EVIL},
        {
            "message": "propose",
            "route": 1,
            "topic": "/x",
            "remote_topic": "/x",
            "from_client": True,
            "transport": _EVIL,
        },
        {"message": "propose", "route": 1, "topic": "/x", "remote_topic": "/x", "from_client": True, "type": _EVIL},
        {"message": "refuse", "route": 2, "code": _EVIL * 10_000, "reason": "x"},
        {"message": "x" * 900_000},
        {"message": "ping", "n": 1, "sent": 1, _EVIL: 1, "received": _EVIL},
        {"message": "report", "sent": [{"route": 1, "dropped": {_EVIL: 1}}], "received": []},
    ]
    for number in count():
        with contextlib.suppress(OSError, AssertionError), _rogue(target) as rogue:
            rogue.say_raw(msgspec.msgpack.encode(texts[number % len(texts)]))
            tally["texts"] += 1
            rogue.drain_for(0.1)


ATTACKS = {
    "pings": Attack(pings, "pings without end, whose answers it does not read", {"pings": 1000}),
    "proposals": Attack(proposals, "proposals without end", {"proposals": 1000}),
    "control": Attack(control, "changes of a topic's rate without end", {"messages": 1000}),
    "ports": Attack(
        ports, "64 of DDS's own ports, and 64 others", {"reserved ports refused": 1}, protocol="udp", stage="nodes"
    ),
    "routes": Attack(routes, "as many topics with streams as it gets", {"streams": 100}, seconds=12.0),
    "types": Attack(types, "types that are known by name alone", {"types": 100}),
    "volatile": Attack(
        volatile, "100,000 messages of 64 kB for a subscriber that is stopped", {"MB": 100}, stage="hoard"
    ),
    "escapes": Attack(escapes, "escape sequences and forged lines", {"texts": 10}),
    "reconnects": Attack(reconnects, "as many authenticated links one after another as it gets", {"links": 50}),
    "oversize": Attack(oversize, "control messages of 0.8 MB", {"MB": 8}),
    "bombs": Attack(bombs, "compressed messages that expand to 60 MB", {"bombs": 10}),
    "pauses": Attack(pauses, "pauses and resumes without end", {"pauses": 1000}),
    "questions": Attack(questions, "questions for topics and types without end", {"questions": 1000}),
}
