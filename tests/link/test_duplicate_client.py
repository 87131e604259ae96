"""Reports of clients that have the name of a linked one, for any number of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

from tests.support.held import held_by
from tests.support.inside import pretend_linked

from rsb_bridge.link.refused_clients import DUPLICATES_KEPT, DuplicateClients
from rsb_bridge.link.roles import ClientRole
from rsb_bridge.model.codes import EventCode
from rsb_bridge.wire.messages import Duplicate

if TYPE_CHECKING:
    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


def test_the_warning_lasts_as_long_as_any_tries() -> None:
    clients = DuplicateClients("robot1")
    assert clients.text(0.0, 1000.0) == ""
    for second in range(0, 60, 4):  # one stops, and the next begins
        clients.tried("10.0.0.9", f"spare{second // 20}", float(second), 1000.0 + second)
    words = "(host spare2) calls itself 'robot1' too, and is refused, for 50 s now: stop one of the two"
    assert words in clients.text(56.0, 1056.0)
    assert clients.text(63.0, 1063.0) == ""
    clients.tried("10.0.0.9", "spare0", 200.0, 1200.0)
    assert "for 1 s now" in clients.text(200.0, 1200.0), "it has begun again"


def test_of_many_a_few_are_kept() -> None:
    clients = DuplicateClients("robot1")
    for number in range(1000):
        clients.tried("10.0.0.9", f"host{number}", 0.001 * number, 1000.0)
    assert clients.news(1.0) == Duplicate("10.0.0.9", "host999", DUPLICATES_KEPT - 1)
    assert held_by(clients) == DUPLICATES_KEPT


def test_last_one_is_named_others_counted() -> None:
    clients = DuplicateClients("robot1")
    clients.tried("10.0.0.8", "spare", 0.0, 1000.0)
    clients.tried("10.0.0.9", "spare", 1.0, 1001.0)
    clients.tried("10.0.0.8", "spare", 2.0, 1002.0)
    assert clients.news(2.0) == Duplicate("10.0.0.9", "spare", 1)
    assert "10.0.0.9 (host spare) and 1 other call themselves" in clients.text(2.0)
    assert clients.news(7.5) == Duplicate("10.0.0.8", "spare")
    assert clients.news(9.0) == Duplicate()
    assert clients.text(9.0) == ""


def test_the_linked_client_says_little_of_many(loop: VirtualLoop, context: Context) -> None:
    link = ClientRole(context, {"robot1": ()}).links()[0]
    pretend_linked(link, SimpleNamespace())
    link.status.up(context.clock.steady())

    def lines() -> int:
        return sum(event.code == EventCode.LINK_NAME_TAKEN for event in context.events.after(0))

    for second in range(59):
        link.handlers[Duplicate](Duplicate("10.0.0.9", f"spare{second}"))
        loop.jump(1.0)
    assert lines() == 1
    assert "for 50 s now" in link.fault.now().warning
    loop.jump(1.0)
    link.handlers[Duplicate](Duplicate("10.0.0.9", "another", 2))
    link.handlers[Duplicate](Duplicate("10.0.0.9", "one more", 2))
    assert lines() == 2
    link.handlers[Duplicate](Duplicate())
    assert link.fault.now().warning == ""
    link.handlers[Duplicate](Duplicate("10.0.0.9", "spare"))
    assert lines() == 3, "it has begun again"
