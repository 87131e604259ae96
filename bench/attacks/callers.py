"""Attackers that have a client's key and carry calls: they ask, answer and provide as nobody should."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from typing import TYPE_CHECKING

from bench.attacks.target import Attack, paced
from tests.support.calls import TYPE
from tests.support.frames import write_frame
from tests.support.rogue import Rogue

from rsb_bridge.ros.native.typesupport import installed_service, service_hash_of
from rsb_bridge.wire.headers import CallFrame, What
from rsb_bridge.wire.messages import Accept, Neighbours, Ping, Propose, Provide
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    from collections.abc import Callable

    from bench.attacks.target import Tally, Target

CALLED = "/called"
"""A service of the server's domain whose server never answers (`Stage.prepare`)."""
ASKED = "/asked"
"""A service that nodes of the server's domain call as fast as they may, and that only an attacker provides."""
ASKED_HZ = 2000.0
OFFERS = "offers in the server's log"
_BATCH = 100
_SIZE = 1000


class _Opening:
    """A route of calls, as long as the server keeps it open."""

    def __init__(self, rogue: Rogue, service: str, *, provides: bool) -> None:
        self.id = rogue.new_route()
        self._rogue = rogue
        rogue.say(
            Propose(
                route=self.id, topic=service, remote_topic=service, from_client=not provides, kind="service",
                timeout=1.0,
            )
        )  # fmt: skip
        rogue.wait_for(Accept)
        self.stream, self._writer = rogue.stream(self.id)

    def provide(self, type_name: str, type_hash: str) -> None:
        self._rogue.say(Provide(self.id, (LaneEntry(type_name, type_hash, 1),), ("/rogue",)))

    def take_back(self) -> None:
        self._rogue.say(Provide(self.id))

    def send(self, what: What, calls: range) -> None:
        """Frames of one kind, all at once."""
        content = b"\x00\x01\x00\x00" + bytes(_SIZE)
        frames = (write_frame(self._writer, CallFrame(what, 0, call, 0, content).pack(), 0) for call in calls)
        self.stream.sendall(b"".join(frames))


def _hash() -> str:
    installed = installed_service(TYPE)
    assert installed is not None
    return service_hash_of(installed)


def _again_and_again(target: Target, tally: Tally, attack: Callable[[Rogue], None]) -> None:
    """Attack on one link after another, each of which stays up while the attack lasts."""
    while True:
        with contextlib.suppress(OSError, AssertionError), _linked(target) as rogue:
            tally["links"] += 1
            threading.Thread(target=_keep_alive, args=(rogue,), daemon=True).start()
            attack(rogue)
        time.sleep(0.05)


def _linked(target: Target) -> Rogue:
    """Link as a bridge that announces itself, since only such a link offers services."""
    rogue = Rogue(target.port, target.key, "rogue", host=target.host)
    rogue.say(Neighbours(("rsb_rogue_00000000",)))
    return rogue


def _keep_alive(rogue: Rogue) -> None:
    with contextlib.suppress(OSError):
        for number in paced(1):
            rogue.say(Ping(number, 0))


def calls(target: Target, tally: Tally) -> None:
    """Calls as fast as the server reads them, to a server that does not answer; what it says is not read."""

    def flood(rogue: Rogue) -> None:
        opening = _Opening(rogue, CALLED, provides=False)
        while not rogue.wait_for(Provide).lanes:
            pass
        for first in itertools.count(1, _BATCH):
            opening.send(What.CALL, range(first, first + _BATCH))
            tally["calls"] += _BATCH

    _again_and_again(target, tally, flood)


def answers(target: Target, tally: Tally) -> None:
    """Answers to calls that were never made, and calls from the side that provides, in turn."""

    def answer(rogue: Rogue) -> None:
        for number in itertools.count():
            opening = _Opening(rogue, ASKED, provides=True)
            opening.provide(TYPE, _hash())
            what = (What.ANSWER, What.REFUSED, What.CALL)[number % 3]
            with contextlib.suppress(OSError):
                opening.send(what, range(1_000_000, 1_000_000 + _BATCH))
            tally["openings"] += 1

    _again_and_again(target, tally, answer)


def provides(target: Target, tally: Tally) -> None:
    """Another type a hundred times a second, each of which the server would have to offer."""

    def provide(rogue: Rogue) -> None:
        for number in paced(200):
            if number % 100 == 0:  # the server ends one whose type has changed before DDS has forgotten the last one
                opening = _Opening(rogue, f"/changing{number}", provides=True)
            if number % 2:
                opening.take_back()
                continue
            half = f"RIHS01_{number:064x}"
            opening.provide(f"made_up_msgs/srv/Blob{number}", f"{half}+{half}")
            tally["types"] += 1

    _again_and_again(target, tally, provide)


def withdraws(target: Target, tally: Tally) -> None:
    """Provides a service and takes it back, as fast as the server reads that."""

    def withdraw(rogue: Rogue) -> None:
        opening = _Opening(rogue, "/blinking", provides=True)
        type_hash = _hash()
        threading.Thread(target=rogue.drain, daemon=True).start()
        while True:
            opening.provide(TYPE, type_hash)
            opening.take_back()
            tally["withdrawals"] += 1

    _again_and_again(target, tally, withdraw)


def silent(target: Target, tally: Tally) -> None:
    """Provides what nodes of the server's domain call as fast as they may, and never answers."""

    def hold(rogue: Rogue) -> None:
        opening = _Opening(rogue, ASKED, provides=True)
        opening.provide(TYPE, _hash())
        while data := opening.stream.recv(1 << 20):
            tally["bytes of calls"] += len(data)

    _again_and_again(target, tally, hold)


ATTACKS = {
    "calls": Attack(calls, "calls without end, to a service that never answers", {"calls": 5000}, stage="called"),
    "answers": Attack(
        answers, "answers to calls that nobody made, and calls the wrong way", {"openings": 10}, stage="asked"
    ),
    "provides": Attack(provides, "a service whose type changes 100 times a second", {"types": 300, OFFERS: 50}),
    "withdraws": Attack(
        withdraws,
        "a service that is provided and taken back as fast as the server reads it",
        {"withdrawals": 300, OFFERS: 300},
    ),
    "silent": Attack(
        silent, "a service that never answers its 2,000 calls a second", {"bytes of calls": 100_000}, stage="asked"
    ),
}
