"""Compares both sides' counts of a service's calls with its callers' and servers' counts."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, NamedTuple

from tests.support.bridge import route
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.api import EngineApi
    from rsb_bridge.engine import Engine
    from rsb_bridge.model.calls import CallsSnapshot

_LOOKS_EVERY = 0.02
AT_ONCE = 10.0
"""s; what is not withdrawn at once is there for as long as DDS takes to forget a dead process, or for good."""


def called(name: str, **more: object) -> Topic:
    """A service of the server's domain, which the client's may call."""
    return Topic(name, "transmit", kind="service", **more)  # type: ignore[arg-type]


def counts(engine: EngineApi, name: str) -> CallsSnapshot:
    found = route(engine, name).calls
    assert found is not None
    return found


class Counts(NamedTuple):
    """Calls, by outcome.

    Attributes:
        answered: with an answer that went back.
        expired: given up after the timeout.
        lost: given up as the link or the provider went.
    """

    asked: int = 0
    answered: int = 0
    expired: int = 0
    refused: int = 0
    lost: int = 0


def settled(engine: EngineApi, name: str, **expected: int) -> CallsSnapshot:
    """Wait until a side counts this, with nothing in flight; counts that are not named are 0."""
    wanted = Counts(**expected)

    def done() -> CallsSnapshot | None:
        found = counts(engine, name)
        return found if not found.in_flight and _counts(found) == wanted else None

    try:
        return eventually(done)
    except AssertionError:
        raise AssertionError(f"{counts(engine, name)}, not {wanted}") from None


def _counts(calls: CallsSnapshot) -> Counts:
    return Counts(calls.asked, calls.answered, calls.expired, sum(calls.refused.values()), calls.lost)


@contextlib.contextmanager
def balanced(*engines: EngineApi) -> Iterator[None]:
    """Watch all the time that asked = answered + expired + refused + lost + in flight, and none of it shrinks."""
    over, faults = threading.Event(), list[str]()
    last: dict[tuple[int, str], CallsSnapshot] = {}

    def look() -> None:
        for number, engine in enumerate(engines):
            for each in engine.snapshot().routes:
                if each.calls is not None:
                    faults.extend(_faults(last.get((number, each.key)), each.calls))
                    last[number, each.key] = each.calls

    def watch() -> None:
        while not over.wait(_LOOKS_EVERY):
            look()

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    look()
    assert last, "no calls were looked at"
    assert not faults, faults[:3]


def _faults(before: CallsSnapshot | None, now: CallsSnapshot) -> list[str]:
    faults = []
    if now.asked != sum(_counts(now)[1:]) + now.in_flight or now.in_flight < 0:
        faults.append(f"does not balance: {now}")
    if before is not None and any(new < old for new, old in zip(_counts(now), _counts(before), strict=True)):
        faults.append(f"a count shrinks: {before}, {now}")
    return faults


def nothing_left(*engines: Engine) -> None:
    """Wait until no call is in flight, and the links' budgets for calls are free."""
    for engine in engines:
        for link in inside(engine).role.links():
            for budget in (link.budget.asked, link.budget.provided):
                eventually(lambda budget=budget: budget.held == (0, 0), what=f"no calls held by {link.name}")
